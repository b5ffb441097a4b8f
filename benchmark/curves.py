"""Learning curves on disk: one CSV file a run, a line for each step that was recorded."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmark.files import write_whole
from datagen.errors import CorruptFile

Curve = list[dict[str, float]]
"""Quantities by name; not every point has all of them."""


def save_curve(path: Path, curve: Sequence[Mapping[str, float]]) -> None:
    """Write a curve; floats are written such that they are read back exactly, and what a point lacks stays empty."""
    names = list(dict.fromkeys(name for point in curve for name in point))
    lines = [",".join(repr(float(point[name])) if name in point else "" for name in names) for point in curve]
    write_whole(path, ("\n".join([",".join(names), *lines]) + "\n").encode())


def load_curve(path: Path) -> Curve | None:
    """A curve as it was written; None where there is none.

    Raises:
        CorruptFile: it is damaged.
    """
    if not path.exists():
        return None
    try:
        with path.open(newline="", encoding="utf-8") as file:
            points = list(csv.DictReader(file, strict=True))
        return [{name: float(value) for name, value in point.items() if value} for point in points]
    except (OSError, ValueError, TypeError, AttributeError, csv.Error) as error:
        raise CorruptFile(f"{path} is damaged ({error}); delete it: it is not needed for the scores.") from None
