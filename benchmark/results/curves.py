"""Learning curves on disk: one CSV file a run, a line for each step that was recorded."""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from benchmark.results.csv_files import read_csv
from datagen.errors import CorruptFile
from datagen.storage.atomic import write_atomically

CLOCKS = ("step", "seconds")
"""Columns in which learning curves count time."""

Curve = list[dict[str, float]]
"""Quantities by name; not every point has all of them."""


def save_curve(path: Path, curve: Sequence[Mapping[str, float]]) -> None:
    """Write a curve; floats are written such that they are read back exactly, and what a point lacks stays empty."""
    names = list(dict.fromkeys(name for point in curve for name in point))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([repr(float(point[name])) if name in point else "" for name in names] for point in curve)
    write_atomically(path, text.getvalue().encode())


def load_curve(path: Path) -> Curve | None:
    """Load a curve as it was written; None where there is none.

    Raises:
        CorruptFile: it is damaged.
    """
    if not path.exists():
        return None
    try:
        return parse_curve(*read_csv(path))
    except (OSError, ValueError) as error:
        raise CorruptFile(f"{path} is damaged ({error}); delete it: it is not needed for the scores.") from None


def parse_curve(names: Sequence[str], lines: Iterable[Sequence[str]]) -> Curve:
    """Read a curve from its column names and the cells of its lines; what a point lacks is an empty cell.

    Raises:
        ValueError: a cell is no number, its time is not finite, or a line has another number of cells.
    """
    curve = [{name: float(cell) for name, cell in zip(names, cells, strict=True) if cell} for cells in lines]
    for clock in CLOCKS:
        if not all(math.isfinite(point.get(clock, 0.0)) for point in curve):
            raise ValueError(f"{clock} holds a value that is not finite")
    return curve
