"""The run folder: finished rows, their scores scene by scene, and their label maps.

OUT/
    runs/NAME.json .... one `RunRow`; it is written last, and in one piece: it makes the row count
    scenes/NAME.csv ... one line a scene: every metric's mean over its frames, over how many, and counts
    labels/NAME.h5 .... the label maps, from which everything else can be computed again
    curves/NAME.csv ... the learning curve, of models that keep one
    training/ ......... models' own files: checkpoints, pictures
    watched/ .......... scores on validation clips while models learn, which go into the curves
with NAME = track--model--seed--8 hex digits of the key. What else lies in OUT is made from these.
Folders in the packed form of `benchmark.packed_runs` are read in the same way and never written to.
"""

import dataclasses
import hashlib
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from benchmark.csv_files import read_csv
from benchmark.curves import load_curve, save_curve
from benchmark.files import write_whole
from benchmark.metrics import CLIP_METRICS, METRICS
from benchmark.model_spec import Kind
from benchmark.packed_runs import SCENES_FILE, is_packed, packed_rows, packed_scenes
from datagen.errors import CorruptFile, UsageError
from datagen.safe_io import MOST_JSON_BYTES, brief_reason, parse_json, read_text
from datagen.wording import counted

RUNS, SCENES, LABELS, CURVES, TRAINING = "runs", "scenes", "labels", "curves", "training"
COUNTS = ("objects", "one_object", "undefined", "identity_switches", "ignored")
"""Columns of a scene's line behind its metrics: objects (mean over frames), frames with one object, frames in which a
metric is undefined, identity switches, ignored pixels."""

SCORES = (*METRICS, *CLIP_METRICS)
"""Columns whose values lie between -1 and 1."""
ROUNDING = 1e-6
"""Largest excess of a stored score."""

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
    if row.learning_curve:
        save_curve(_curve_path(folder, row.key.name), row.learning_curve)
    text = json.dumps(plain_values(row), indent=1, default=str) + "\n"
    write_whole(row_path(folder, row.key), text.encode())


def plain_values(row: RunRow) -> dict[str, Any]:
    """Turn a row into values for JSON; its learning curve is left out, and nan, which JSON lacks, becomes None."""
    values = dataclasses.asdict(row)
    del values["learning_curve"]
    values["measured"] = {name: cost if math.isfinite(cost) else None for name, cost in values["measured"].items()}
    return storable(values)


def storable(value: Any) -> Any:
    """Replace what `load_row` would refuse in values of foreign models: other infinite numbers, and broken UTF-16."""
    if isinstance(value, dict):
        return {name: storable(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [storable(item) for item in value]
    if isinstance(value, str):
        return value.encode(errors="replace").decode()
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def row_path(folder: Path, key: RunKey) -> Path:
    """Where a row is or will be."""
    return folder / RUNS / f"{key.name}.json"


def load_runs(folder: Path) -> list[RunRow]:
    """Load all rows of a run folder, ordinary or packed, ordered by their keys; none where there is no such folder yet.

    Raises:
        UsageError: the folder has rows in both forms.
        CorruptFile: a row is damaged.
    """
    paths = sorted((folder / RUNS).glob("*.json"))
    if not is_packed(folder):
        return sorted(map(load_row, paths), key=lambda row: row.key)
    if paths:
        raise UsageError(
            f"{folder} holds packed results, and rows of its own in {RUNS}/. Move that folder elsewhere, and add its "
            "rows with: obpose-bench pack."
        )
    return sorted((_packed_row(folder, values) for values in packed_rows(folder)), key=lambda row: row.key)


def _packed_row(folder: Path, values: dict[str, Any]) -> RunRow:
    try:
        own = {name: value for name, value in values.items() if name not in ("name", "scenes", "curve")}
        return _row(values["name"], own)
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise CorruptFile(
            f"{folder} has a damaged row, {values['name']:.200} ({brief_reason(error)}). Get it again."
        ) from None


def check_runs(folder: Path) -> list[RunRow]:
    """As `load_runs`, where there must be some.

    Raises:
        UsageError: the folder holds no rows.
    """
    if rows := load_runs(folder):
        return rows
    raise UsageError(f"{folder} holds no finished runs; give a folder that obpose-bench wrote with --out.")


def load_row(path: Path) -> RunRow:
    """Load one row.

    Raises:
        CorruptFile: it is damaged.
    """
    try:
        # Rows of older versions have NaN where a cost was not measured; JSON has no such number.
        values = parse_json(re.sub(r": NaN(?=,?$)", ": null", read_text(path, MOST_JSON_BYTES), flags=re.MULTILINE))
        if not isinstance(values, dict):
            raise ValueError(f"it holds a {type(values).__name__}, expected an object")
        return _row(path.stem, {**values, "learning_curve": load_curve(_curve_path(path.parent.parent, path.stem))})
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise CorruptFile(
            f"{path} is damaged ({brief_reason(error)}); delete it and run the same command again."
        ) from None


def _row(name: str, values: dict[str, Any]) -> RunRow:
    """Build the row of that name from plain values; raises ValueError, TypeError, KeyError or AttributeError."""
    json.dumps(values, ensure_ascii=False).encode()  # raises ValueError for text that cannot be written again
    costs = {name: math.nan if cost is None else cost for name, cost in values["measured"].items()}
    key, measured = build_checked(RunKey, values["key"]), build_checked(Measured, costs)
    if key.name != name or not {"/", "\0"}.isdisjoint(name):
        raise ValueError(f"it holds the row {key.name}")
    if not isinstance(values["priors"], list) or not all(isinstance(prior, str) for prior in values["priors"]):
        raise TypeError(f"priors is {values['priors']!r:.40}")
    return build_checked(RunRow, {**values, "key": key, "measured": measured, "priors": tuple(values["priors"])})


def build_checked(kind: type[Any], values: Mapping[str, Any]) -> Any:
    """Build a dataclass from values of a file.

    Raises:
        TypeError: a field is missing or unknown, or a plain value is none of those that its field may have.
    """
    hints = get_type_hints(kind)
    required = [field.name for field in dataclasses.fields(kind) if _is_required(field)]
    if missing := [name for name in required if name not in values]:
        raise TypeError(f"{missing[0]} is missing")
    if unknown := [name for name in values if name not in hints]:
        raise TypeError(f"it has an unknown field {unknown[0]:.40}")
    for name, hint in hints.items():
        if name not in values:
            continue
        value = values[name]
        plain = hint in (str, int, float, bool)
        wrong = (plain and type(value) is not hint) or (get_origin(hint) is dict and not isinstance(value, dict))
        if wrong or (get_origin(hint) is Literal and value not in get_args(hint)) or (type(value) is int and value < 0):
            raise TypeError(f"{name} is {value!r:.40}")
    return kind(**values)


def _is_required(field: dataclasses.Field[Any]) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def delete_rows(folder: Path, rows: Iterable[RunRow]) -> None:
    """Forget rows, with their scores, label maps and learning curves; what a model keeps for itself stays."""
    for row in rows:
        row_path(folder, row.key).unlink(missing_ok=True)
        (folder / SCENES / f"{row.key.name}.csv").unlink(missing_ok=True)
        (folder / LABELS / f"{row.key.name}.h5").unlink(missing_ok=True)
        _curve_path(folder, row.key.name).unlink(missing_ok=True)


def _curve_path(folder: Path, name: str) -> Path:
    return folder / CURVES / f"{name}.csv"


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
    """Load the scores of a row scene by scene, from an ordinary or a packed folder.

    Raises:
        CorruptFile: the table is missing or damaged.
    """
    if is_packed(folder):
        return _packed_scenes(folder, row)
    path = folder / SCENES / f"{row.key.name}.csv"
    try:
        header, lines = read_csv(path)
        values = np.array(lines, np.float64).reshape(len(lines), len(header))
        return _checked({name: values[:, column] for column, name in enumerate(header)}, row)
    except (OSError, ValueError) as error:
        raise CorruptFile(f"{path} is missing or damaged ({error}); restore it with: obpose-bench rescore.") from None


def _packed_scenes(folder: Path, row: RunRow) -> SceneTable:
    try:
        return _checked(packed_scenes(folder, row.key.name), row)
    except ValueError as error:
        path = folder / SCENES_FILE
        raise CorruptFile(f"{path} is damaged ({row.key.name}: {error}). Get the file again.") from None


def _checked(table: SceneTable, row: RunRow) -> SceneTable:
    """Raises ValueError where a table has not the row's scenes, lacks a column, or has a value that is no score."""
    scenes = max((len(values) for values in table.values()), default=0)
    if scenes != row.n_scenes or not scenes:
        raise ValueError(f"{counted(scenes, 'scene')} where the row has {row.n_scenes}")
    if missing := [name for name in SCORES if not {name, f"{name}_n"} <= set(table)]:
        raise ValueError(f"no column {missing[0]}")
    _check_values(table)
    return table


def _check_values(table: SceneTable) -> None:
    """Check that scenes are numbered from 0, counts are counts, and means are finite where their count is not 0."""
    if "scene" not in table or not np.array_equal(table["scene"], np.arange(len(table["scene"]))):
        raise ValueError("its scenes are not numbered 0, 1, ...")
    for name, values in table.items():
        if name.endswith("_n") or name in ("n_frames", *COUNTS):
            good, expected = np.isfinite(values) & (values >= 0), "a count"
        elif name == "scene":
            continue
        elif f"{name}_n" not in table:
            raise ValueError(f"no column {name}_n")
        else:
            within = np.abs(values) <= (1 + ROUNDING if name in SCORES else np.inf)
            good, expected = (table[f"{name}_n"] == 0) | (np.isfinite(values) & within), "a score"
        if not good.all():
            raise ValueError(f"{name} holds {values[~good][0]}, expected {expected}")


def pooled(table: SceneTable, metric: str) -> float:
    """A split's mean of a metric: over all frames in which it is defined, as the paper pools; nan where in none."""
    values, weights = table[metric], table[f"{metric}_n"]
    total = weights.sum()
    return float(np.sum(np.where(weights > 0, values, 0.0) * weights) / total) if total else float("nan")
