"""The run folder: finished rows, their scores scene by scene, and their label maps.

OUT/
    runs/NAME.json .... one `RunRow`; it is written last and atomically, and only then counts as finished
    scenes/NAME.csv ... one line per scene: the mean of every metric, its number of frames, and counts
    labels/NAME.h5 .... the label maps, from which all scores can be recomputed
    curves/NAME.csv ... the learning curve, if the model records one
    reconstructions/NAME/ ... a few scenes as the model renders them, if it can
    training/ ......... files of models: checkpoints, pictures
    watched/ .......... validation scores during training, which are added to the curves
with NAME = track--model--seed--8 hex digits of the key. All other files in OUT are derived from these.
Folders in the packed form of `benchmark.results.packed_runs` are read in the same way and never written to.
"""

import dataclasses
import hashlib
import json
import math
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmark.csv_files import load_curve, read_csv, save_curve
from benchmark.metrics import CLIP_METRICS, METRICS, OTHER_METRICS, mean_where_defined
from benchmark.models.model_spec import Kind
from benchmark.results.packed_runs import SCENES_FILE, is_packed, packed_rows, packed_scenes
from datagen.console.text import counted
from datagen.errors import CorruptFile, UsageError
from datagen.storage.atomic import write_atomically
from datagen.storage.safe_io import MOST_JSON_BYTES, brief_reason, parse_json, read_text
from datagen.storage.structure import strict_converter, structure

RUNS, SCENES, LABELS, CURVES, TRAINING = "runs", "scenes", "labels", "curves", "training"
RECONSTRUCTIONS = "reconstructions"
COUNTS = ("objects", "one_object", "undefined", "identity_switches", "ignored")
"""Columns after the metrics of a scene's line: objects (mean over frames), frames with one object, frames in which a
metric is undefined, identity switches, ignored pixels."""

SCORES = (*METRICS, *CLIP_METRICS)
"""Columns of every table; their values lie between -1 and 1."""
ROUNDING = 1e-6
"""Tolerance of the range check, as stored scores are rounded."""

SceneTable = dict[str, np.ndarray]
"""Column name to float64 array over scenes: `scene`, `n_frames`, `<metric>`, `<metric>_n`, and `COUNTS`."""


@dataclass(frozen=True, order=True)
class RunKey:
    """Identity of a row; a row with an equal key is never computed twice."""

    track: str
    fit_track: str
    """Track fitted, or tuned, on; equals `track` if that is the scored track itself."""
    model: str
    seed: int
    version: int
    """Version of the model."""
    config_hash: str
    """SHA-256 of the settings that were known before the run: the declared grid, budgets, options."""
    fit_spec: str
    """`spec_hash` of the dataset that the model was fitted on."""
    track_spec: str
    """`spec_hash` of the dataset that the model was scored on."""

    @property
    def name(self) -> str:
        """File name of the row, without suffix."""
        return f"{self.track}--{self.model}--{self.seed}--{digest(dataclasses.asdict(self))[:8]}"

    @property
    def place(self) -> tuple[str, str, str, int]:
        """Position of the row in tables; a run folder has one row per place."""
        return self.track, self.fit_track, self.model, self.seed


@dataclass(frozen=True)
class Measured:
    """Measured costs, which vary between runs; tables name them `measured_*`. nan (null in files) if not measured."""

    seconds_per_frame: float
    """Wall time of `segment` per frame and view, without reading and scoring."""
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
    """Reason of the failure; empty if the run succeeded."""
    config: dict[str, Any]
    """The values the model ran with, tuned ones included."""
    tuned: bool
    """Whether values were chosen by scores on the validation split, which uses labels."""
    uses_labels: bool
    """Whether the model itself saw labels."""
    kind: Kind
    priors: tuple[str, ...]
    """Inputs of the model beside the clips, such as the number of slots."""
    random: bool
    """Whether results depend on the seed; if not, one run stands for all seeds."""
    n_scenes: int
    """Number of scored scenes; 0 if the run failed."""
    parameters: int
    """Number of learned parameters; 0 for models that learn nothing."""
    device: str
    commit: str
    """Commit of the code that ran; recorded, not part of the key."""
    measured: Measured
    pretrained: str = ""
    """Name of the weights that were used in place of training; empty if the run trained."""
    views: str = ""
    """Views of a frame that the model gets and that supervise it; empty if undeclared or if there is only one view."""
    trials: int = 0
    """Number of values compared by validation scores, if known."""
    learning_curve: list[dict[str, float]] | None = field(default=None)
    """Learning curve recorded in training, one dict per recorded step; kept in `curves/`."""


def digest(values: Mapping[str, Any]) -> str:
    """SHA-256 of plain values; values that JSON cannot represent are converted to text."""
    return hashlib.sha256(json.dumps(values, sort_keys=True, separators=(",", ":"), default=str).encode()).hexdigest()


def save_row(folder: Path, row: RunRow) -> None:
    """Write a row, after its learning curve; once written, the row counts as finished."""
    if row.learning_curve:
        save_curve(_curve_path(folder, row.key.name), row.learning_curve)
    text = json.dumps(plain_values(row), indent=1, default=str) + "\n"
    write_atomically(row_path(folder, row.key), text.encode())


def plain_values(row: RunRow) -> dict[str, Any]:
    """Convert a row to JSON values. The learning curve is left out; nan, which JSON lacks, becomes None."""
    values = dataclasses.asdict(row)
    del values["learning_curve"]
    values["measured"] = {name: cost if math.isfinite(cost) else None for name, cost in values["measured"].items()}
    return storable(values)


def storable(value: Any) -> Any:
    """Replace values that `load_row` would reject: nan, infinite numbers and unpaired surrogates in text."""
    if isinstance(value, dict):
        return {name: storable(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [storable(item) for item in value]
    if isinstance(value, str):
        return value.encode(errors="replace").decode()
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


_DAMAGE = (ValueError, TypeError, KeyError, AttributeError)
"""Errors that damaged values of a row raise."""


def row_path(folder: Path, key: RunKey) -> Path:
    """Path of a row, whether or not the file exists."""
    return folder / RUNS / f"{key.name}.json"


def load_runs(folder: Path) -> list[RunRow]:
    """Load all rows of a run folder, ordinary or packed, ordered by their keys; none if the folder does not exist yet.

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
    rows = []
    for values in packed_rows(folder):
        own = {name: value for name, value in values.items() if name not in ("name", "scenes", "curve")}
        try:
            rows.append(_row(values["name"], own))
        except _DAMAGE as error:
            reason = brief_reason(error)
            raise CorruptFile(f"{folder} has a damaged row, {values['name']:.200} ({reason}). Get it again.") from None
    return sorted(rows, key=lambda row: row.key)


def check_runs(folder: Path) -> list[RunRow]:
    """Load all rows of a run folder, as `load_runs` does, and require at least one.

    Raises:
        UsageError: the folder holds no rows.
    """
    if rows := load_runs(folder):
        return rows
    raise UsageError(f"{folder} holds no finished runs; give a folder that obpose-bench wrote with --out.")


def load_row(path: Path) -> RunRow:
    """Load one row.

    Raises:
        CorruptFile: the file is damaged.
    """
    try:
        # Rows of older versions have NaN where a cost was not measured; JSON has no such number.
        values = parse_json(re.sub(r": NaN(?=,?$)", ": null", read_text(path, MOST_JSON_BYTES), flags=re.MULTILINE))
        if not isinstance(values, dict):
            raise ValueError(f"it holds a {type(values).__name__}, expected an object")
        return _row(path.stem, {**values, "learning_curve": load_curve(_curve_path(path.parent.parent, path.stem))})
    except _DAMAGE as error:
        raise CorruptFile(
            f"{path} is damaged ({brief_reason(error)}); delete it and run the same command again."
        ) from None


def _row(name: str, values: dict[str, Any]) -> RunRow:
    """Build the row of that name from plain values; raises an error of `_DAMAGE` if they are damaged."""
    json.dumps(values, ensure_ascii=False).encode()  # raises ValueError for text that cannot be written again
    # JSON has no nan, which stands for costs that were not measured.
    costs = values["measured"]
    known = {cost: 0.0 if value is None else value for cost, value in costs.items()}
    plain = {field: value for field, value in values.items() if field != "learning_curve"}
    row = structure({**plain, "measured": known}, RunRow, strict_converter())
    missing = {cost: math.nan for cost, value in costs.items() if value is None}
    row = replace(row, measured=replace(row.measured, **missing), learning_curve=values.get("learning_curve"))
    for count in ("key.seed", "key.version", "n_scenes", "parameters", "trials"):
        if attrgetter(count)(row) < 0:
            raise ValueError(f"$.{count} is negative")
    if row.key.name != name or not {"/", "\0"}.isdisjoint(name):
        raise ValueError(f"it holds the row {row.key.name}")
    return row


def delete_rows(folder: Path, rows: Iterable[RunRow]) -> None:
    """Delete rows and all files of their names; the models' own files in `training/` stay."""
    for row in rows:
        row_path(folder, row.key).unlink(missing_ok=True)
        (folder / SCENES / f"{row.key.name}.csv").unlink(missing_ok=True)
        (folder / LABELS / f"{row.key.name}.h5").unlink(missing_ok=True)
        _curve_path(folder, row.key.name).unlink(missing_ok=True)
        shutil.rmtree(folder / RECONSTRUCTIONS / row.key.name, ignore_errors=True)


def _curve_path(folder: Path, name: str) -> Path:
    return folder / CURVES / f"{name}.csv"


def scene_line(scene: int, scores: Mapping[str, np.ndarray]) -> dict[str, float | int]:
    """Build a scene table's line from the scene's scores, as `benchmark.metrics.clip_scores` returns them."""
    metrics = {name: values for name, values in scores.items() if name not in COUNTS}
    line: dict[str, float | int] = {"scene": scene, "n_frames": len(scores["objects"])}
    for name, values in metrics.items():
        line |= {name: mean_where_defined(values), f"{name}_n": int(np.sum(~np.isnan(values)))}
    return line | {
        "objects": float(np.mean(scores["objects"])),
        "one_object": int(np.sum(scores["objects"] == 1)),
        "undefined": int(np.any([np.isnan(scores[name]) for name in METRICS], axis=0).sum()),
        "identity_switches": int(np.sum(scores["identity_switches"])),
        "ignored": int(np.sum(scores["ignored"])),
    }


def save_scenes(folder: Path, name: str, lines: Iterable[Mapping[str, float | int]]) -> None:
    """Write a scene table line by line; floats keep full precision."""
    write_atomically(folder / SCENES / f"{name}.csv", (f"{row}\n".encode() for row in _csv_rows(lines)))


def _csv_rows(lines: Iterable[Mapping[str, float | int]]) -> Iterator[str]:
    for number, line in enumerate(lines):
        if number == 0:
            yield ",".join(line)
        yield ",".join(map(repr, line.values()))


def load_scenes(folder: Path, row: RunRow) -> SceneTable:
    """Load the scores of a row scene by scene, from an ordinary or a packed folder.

    Raises:
        CorruptFile: the table is missing or damaged.
    """
    if is_packed(folder):
        try:
            return _checked(packed_scenes(folder, row.key.name), row)
        except ValueError as error:
            path = folder / SCENES_FILE
            raise CorruptFile(f"{path} is damaged ({row.key.name}: {error}). Get the file again.") from None
    path = folder / SCENES / f"{row.key.name}.csv"
    try:
        header, lines = read_csv(path)
        values = np.array(lines, np.float64).reshape(len(lines), len(header))
        return _checked({name: values[:, column] for column, name in enumerate(header)}, row)
    except (OSError, ValueError) as error:
        raise CorruptFile(f"{path} is missing or damaged ({error}); restore it with: obpose-bench rescore.") from None


def _checked(table: SceneTable, row: RunRow) -> SceneTable:
    """Check a scene table. Raises ValueError for a wrong number of scenes, a missing column or an invalid score."""
    scenes = max((len(values) for values in table.values()), default=0)
    if scenes != row.n_scenes or not scenes:
        raise ValueError(f"{counted(scenes, 'scene')} where the row has {row.n_scenes}")
    if missing := [name for name in SCORES if not {name, f"{name}_n"} <= set(table)]:
        raise ValueError(f"no column {missing[0]}")
    # Scenes are numbered from 0, counts are counts, and means are finite where their count is not 0.
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
            within = np.abs(values) <= (1 + ROUNDING if name in (*SCORES, *OTHER_METRICS) else np.inf)
            good, expected = (table[f"{name}_n"] == 0) | (np.isfinite(values) & within), "a score"
        if not good.all():
            raise ValueError(f"{name} holds {values[~good][0]}, expected {expected}")
    return table
