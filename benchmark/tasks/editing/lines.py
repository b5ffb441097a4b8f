"""Scores of edits on disk: one CSV file per model and track, with a line per scene, edit and answer.

A file grows scene by scene while its job runs, so that a stopped job can resume. A scene without edits has one line
with an empty edit, which marks it as done.
"""

import math
from collections.abc import Sequence
from pathlib import Path

from benchmark.csv_files import Line, read_csv, to_csv
from benchmark.tasks.editing.answers import METRICS, Answer
from benchmark.tasks.editing.truth import Pair
from datagen.errors import CorruptFile
from datagen.schema import EDITS
from datagen.storage.atomic import write_atomically

FOLDER = "editing"
"""Subfolder of the run folder for these files."""

COLUMNS = ("track", "model", "scene", "edit", "answer", "object", "iou", "found", *METRICS)
"""Columns of a line. `object`: id in the ground truth; `iou`: IoU of the label matched to the object; `found`: whether
that IoU is large enough, empty for answers that need no match."""


def line_of(track: str, model: str, scene: int, pair: Pair, answer: Answer) -> Line:
    """Build the line of one scored answer."""
    found = answer.match
    return {
        "track": track,
        "model": model,
        "scene": scene,
        "edit": pair.kind,
        "answer": answer.name,
        "object": pair.object,
        "iou": found.iou if found else "",
        "found": ("" if found is None else "no" if found.label is None else "yes"),
        **answer.scores,
    }


def line_without_edit(track: str, model: str, scene: int) -> Line:
    """Build the line of a scene that has nothing to edit."""
    return {**dict.fromkeys(COLUMNS, ""), "track": track, "model": model, "scene": scene}


def path_of(folder: Path, name: str) -> Path:
    """Path of a job's lines, whether or not the file exists."""
    return folder / FOLDER / f"{name}.csv"


def save_lines(path: Path, lines: Sequence[Line]) -> None:
    """Write all lines of a job."""
    text = to_csv(list(lines)) if lines else ",".join(COLUMNS) + "\n"
    write_atomically(path, text.encode())


def load_lines(path: Path) -> list[Line]:
    """Load the lines of a job; none if it has not begun.

    Raises:
        CorruptFile: the file is damaged.
    """
    if not path.exists():
        return []
    try:
        names, lines = read_csv(path)
        if tuple(names) != COLUMNS:
            raise ValueError(f"its columns are {', '.join(names):.80}")
        return [_typed(dict(zip(names, cells, strict=True))) for cells in lines]
    except (OSError, ValueError) as error:
        raise CorruptFile(f"{path} is damaged ({error}); delete it and run the same command again.") from None


def load_all(folder: Path) -> list[Line]:
    """Load the lines of all jobs of a run folder, without those of scenes that have nothing to edit."""
    paths = sorted((folder / FOLDER).glob("*.csv"))
    return [line for path in paths for line in load_lines(path) if line["edit"]]


def _typed(row: dict[str, str]) -> Line:
    """Parse the cells of one line; raises ValueError if `line_of` would not write such a cell."""
    if row["edit"] not in ("", *EDITS) or row["found"] not in ("", "no", "yes"):
        raise ValueError(f"a line has edit {row['edit']!r:.40} and found {row['found']!r:.40}")
    numbers = {name: float(row[name]) if row[name] else math.nan for name in METRICS}
    scene = int(row["scene"])
    if scene < 0 or math.inf in map(abs, numbers.values()):
        raise ValueError(f"a line of scene {scene} has a score that is infinite, or an invalid scene")
    return {**row, "scene": scene, **numbers}
