"""The run folder: finished rows, their scores scene by scene, and their label maps.

OUT/
    runs/NAME.json .... one `RunRow`; it is written last, and in one piece: it makes the row count
    scenes/NAME.csv ... one line a scene: every metric's mean over its frames, over how many, and counts
    labels/NAME.h5 .... the label maps, from which everything else can be computed again
    curves/NAME.csv ... the learning curve, of models that keep one
    training/ ......... models' own files: checkpoints, pictures
    watched/ .......... scores on validation clips while models learn, which go into the curves
with NAME = track--model--seed--8 hex digits of the key. What else lies in OUT is made from these.
"""

import csv
import dataclasses
import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from benchmark.curves import load_curve, save_curve
from benchmark.files import write_whole
from benchmark.metrics import METRICS
from benchmark.model_spec import Kind
from datagen.errors import CorruptFile, UsageError

RUNS, SCENES, LABELS, CURVES, TRAINING = "runs", "scenes", "labels", "curves", "training"
COUNTS = ("objects", "one_object", "undefined", "identity_switches", "ignored")
"""Columns of a scene's line behind its metrics: objects (mean over frames), frames with one object, frames in which a
metric is undefined, identity switches, ignored pixels."""

SceneTable = dict[str, np.ndarray]
"""Column name to float64 array over scenes: `scene`, `n_frames`, `<metric>`, `<metric>_n`, and `COUNTS`."""


@dataclass(frozen=True, order=True)
class RunKey:
    """What a row is of; a row with an equal key is never computed twice."""

    track: str
    fit_track: str
    """Equals `track` where the model was fitted, or tuned, on the track itself."""
    model: str
    seed: int
    version: int
    """Of the model."""
    config_hash: str
    """SHA-256 of the settings that were known before the run: the declared grid, budgets, options."""
    fit_spec: str
    """The `spec_hash` of the dataset that was fitted on."""
    track_spec: str
    """The `spec_hash` of the dataset that was scored on."""

    @property
    def name(self) -> str:
        """File name of the row, without suffix."""
        return f"{self.track}--{self.model}--{self.seed}--{digest(dataclasses.asdict(self))[:8]}"

    @property
    def place(self) -> tuple[str, str, str, int]:
        """Where the row stands in tables: a run folder has one row a place."""
        return self.track, self.fit_track, self.model, self.seed


@dataclass(frozen=True)
class Measured:
    """Costs, which differ from run to run; tables name them `measured_*`. nan, null in files: was not measured."""

    seconds_per_frame: float
    """Wall time of `segment` a frame and view; reading and scoring left out."""
    fit_seconds: float
    """Wall time of fitting, tuning included."""
    peak_mib: float
    """Largest resident memory of the run's process."""


@dataclass(frozen=True)
class RunRow:
    """One finished run, or one that failed."""

    key: RunKey
    status: Literal["ok", "failed"]
    reason: str
    """Why it failed; empty where it did not."""
    config: dict[str, Any]
    """The values the model ran with, tuned ones included."""
    tuned: bool
    """Whether values were chosen by scores on the validation split, which uses labels."""
    uses_labels: bool
    """Whether the model itself saw labels."""
    kind: Kind
    priors: tuple[str, ...]
    """What the model was given beside the clips, such as the number of slots."""
    random: bool
    """Whether seeds differ; if not, one run stands for all seeds."""
    n_scenes: int
    """Scenes that were scored; 0 where the run failed."""
    parameters: int
    """Learned numbers; 0 for models that learn nothing."""
    device: str
    commit: str
    """Of the code that ran; recorded, not part of the key."""
    measured: Measured
    pretrained: str = ""
    """Name of the weights that were used in the place of training; empty where the run trained."""
    views: str = ""
    """How many views of a frame the model gets and how many supervise it, where it says so and there are several."""
    trials: int = 0
    """How many values were compared by these scores, where that is known."""
    learning_curve: list[dict[str, float]] | None = field(default=None)
    """What a model recorded while it trained, a dict for each of some steps; kept in `curves/`."""


def digest(values: Mapping[str, Any]) -> str:
    """SHA-256 of plain values; what JSON does not know counts as its text."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, separators=(",", ":"), default=str).encode()).hexdigest()


def save_row(folder: Path, row: RunRow) -> None:
    """Write a row, and its learning curve before it; from then on it counts."""
    values = dataclasses.asdict(row)
    if curve := values.pop("learning_curve"):
        save_curve(_curve_path(folder, row.key), curve)
    # JSON has no nan.
    values["measured"] = {name: cost if math.isfinite(cost) else None for name, cost in values["measured"].items()}
    text = json.dumps(values, indent=1, default=str) + "\n"
    write_whole(row_path(folder, row.key), text.encode())


def row_path(folder: Path, key: RunKey) -> Path:
    """Where a row is or will be."""
    return folder / RUNS / f"{key.name}.json"


def load_runs(folder: Path) -> list[RunRow]:
    """All rows of a run folder, ordered by their keys; none where there is no such folder yet.

    Raises:
        CorruptFile: a row is damaged.
    """
    return sorted((load_row(path) for path in sorted((folder / RUNS).glob("*.json"))), key=lambda row: row.key)


def check_runs(folder: Path) -> list[RunRow]:
    """As `load_runs`, where there must be some.

    Raises:
        UsageError: the folder holds no rows.
    """
    if rows := load_runs(folder):
        return rows
    raise UsageError(f"{folder} holds no finished runs; give a folder that obpose-bench wrote with --out.")


def load_row(path: Path) -> RunRow:
    """One row.

    Raises:
        CorruptFile: it is damaged.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        costs = {name: math.nan if cost is None else cost for name, cost in values.pop("measured").items()}
        key, measured = _build(RunKey, values.pop("key")), _build(Measured, costs)
        values["learning_curve"] = load_curve(_curve_path(path.parent.parent, key))
        row = _build(RunRow, {**values, "key": key, "measured": measured, "priors": tuple(values["priors"])})
        if path.stem != key.name:
            raise ValueError(f"it holds the row {key.name}")
        return row
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise CorruptFile(f"{path} is damaged ({error}); delete it and run the same command again.") from None


def _build(kind: type[Any], values: Mapping[str, Any]) -> Any:
    """Raises TypeError where a plain value is none of those that its field may have."""
    for name, hint in get_type_hints(kind).items():
        if name not in values:
            continue
        value = values[name]
        plain = hint in (str, int, float, bool)
        if (plain and type(value) is not hint) or (get_origin(hint) is Literal and value not in get_args(hint)):
            raise TypeError(f"{name} is {value!r}")
    return kind(**values)


def delete_rows(folder: Path, rows: Iterable[RunRow]) -> None:
    """Forget rows, with their scores, label maps and learning curves; what a model keeps for itself stays."""
    for row in rows:
        row_path(folder, row.key).unlink(missing_ok=True)
        (folder / SCENES / f"{row.key.name}.csv").unlink(missing_ok=True)
        (folder / LABELS / f"{row.key.name}.h5").unlink(missing_ok=True)
        _curve_path(folder, row.key).unlink(missing_ok=True)


def _curve_path(folder: Path, key: RunKey) -> Path:
    return folder / CURVES / f"{key.name}.csv"


def scene_line(scene: int, scores: Mapping[str, np.ndarray]) -> dict[str, float | int]:
    """One line of a scene table from the scene's scores, as `benchmark.metrics.clip_scores` gives them."""
    metrics = {name: values for name, values in scores.items() if name not in COUNTS}
    line: dict[str, float | int] = {"scene": scene, "n_frames": len(scores["objects"])}
    for name, values in metrics.items():
        defined = values[~np.isnan(values)]
        line |= {name: float(np.mean(defined)) if len(defined) else np.nan, f"{name}_n": len(defined)}
    return line | {
        "objects": float(np.mean(scores["objects"])),
        "one_object": int(np.sum(scores["objects"] == 1)),
        "undefined": int(np.any([np.isnan(scores[name]) for name in METRICS], axis=0).sum()),
        "identity_switches": int(np.sum(scores["identity_switches"])),
        "ignored": int(np.sum(scores["ignored"])),
    }


def save_scenes(folder: Path, name: str, lines: Sequence[Mapping[str, float | int]]) -> None:
    """Write a scene table; floats are written such that they are read back exactly."""
    rows = [",".join(lines[0]), *(",".join(repr(value) for value in line.values()) for line in lines)]
    write_whole(folder / SCENES / f"{name}.csv", ("\n".join(rows) + "\n").encode())


def load_scenes(folder: Path, row: RunRow) -> SceneTable:
    """Scores of a row scene by scene.

    Raises:
        CorruptFile: the table is missing or damaged.
    """
    path = folder / SCENES / f"{row.key.name}.csv"
    try:
        with path.open(newline="", encoding="utf-8") as file:
            header, *lines = csv.reader(file)
        values = np.array(lines, np.float64).reshape(len(lines), len(header))
        if len(lines) != row.n_scenes or not lines:
            raise ValueError(f"{len(lines)} scenes where the row has {row.n_scenes}")
        if missing := [name for name in METRICS if name not in header or f"{name}_n" not in header]:
            raise ValueError(f"no column {missing[0]}")
    except (OSError, ValueError) as error:
        raise CorruptFile(f"{path} is missing or damaged ({error}); restore it with: obpose-bench rescore.") from None
    return {name: values[:, column] for column, name in enumerate(header)}


def pooled(table: SceneTable, metric: str) -> float:
    """A split's mean of a metric: over all frames in which it is defined, as the paper pools; nan where in none."""
    values, weights = table[metric], table[f"{metric}_n"]
    total = weights.sum()
    return float(np.sum(np.where(weights > 0, values, 0.0) * weights) / total) if total else float("nan")
