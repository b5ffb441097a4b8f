"""CSV files of a run folder: any table, and learning curves.

The lines of a table are plain dictionaries. A data frame would turn whole numbers with gaps into floats, and import
pandas for the few lines of `to_csv`.
"""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from datagen.console.text import printable
from datagen.errors import CorruptFile
from datagen.storage.atomic import write_atomically
from datagen.storage.safe_io import read_text

CLOCKS = ("step", "seconds")
"""Columns in which learning curves count time."""

Cell = str | int | float
Line = Mapping[str, Cell]

Curve = list[dict[str, float]]
"""Quantities by name; not every point has all of them."""


def read_csv(path: Path) -> tuple[list[str], list[list[str]]]:
    """Read the column names and the lines of a CSV file, and check that all lines have the same number of cells.

    Raises:
        ValueError: the file is empty, cut short, or not a table.
        CorruptFile: it is too large or not UTF-8.
        UsageError: it is no regular file.
        OSError: it cannot be read.
    """
    text = read_text(path)
    if not text.endswith("\n"):
        raise ValueError("its last line is cut short")
    try:
        names, *lines = csv.reader(io.StringIO(text, newline=""), strict=True)
    except csv.Error as error:
        raise ValueError(str(error)) from None
    if len(set(names)) < len(names):
        raise ValueError("two of its columns have the same name")
    for number, cells in enumerate(lines, start=2):
        if len(cells) != len(names):
            raise ValueError(f"line {number} has {len(cells)} cells; expected {len(names)}")
    return names, lines


def to_csv(lines: Iterable[Line]) -> str:
    """Format lines as CSV with the columns of all of them; floats have six decimals, missing cells are empty."""
    lines = list(lines)
    names = list(dict.fromkeys(name for line in lines for name in line))
    content = io.StringIO(newline="")
    writer = csv.writer(content, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([_csv_cell(line.get(name, "")) for name in names] for line in lines)
    return content.getvalue()


def _csv_cell(value: Cell) -> str:
    if isinstance(value, float):
        return f"{value:z.6f}"
    content = printable(str(value))
    # Spreadsheets would compute a cell that begins like a formula.
    return f"'{content}" if content.startswith(("=", "+", "-", "@")) else content


def save_curve(path: Path, curve: Sequence[Mapping[str, float]]) -> None:
    """Write a learning curve with exact floats; quantities that a point lacks become empty cells."""
    names = list(dict.fromkeys(name for point in curve for name in point))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows([repr(float(point[name])) if name in point else "" for name in names] for point in curve)
    write_atomically(path, text.getvalue().encode())


def load_curve(path: Path) -> Curve | None:
    """Load a learning curve; None if the file does not exist.

    Raises:
        CorruptFile: the file is damaged.
    """
    if not path.exists():
        return None
    try:
        return parse_curve(*read_csv(path))
    except (OSError, ValueError) as error:
        raise CorruptFile(f"{path} is damaged ({error}); delete it: it is not needed for the scores.") from None


def parse_curve(names: Sequence[str], lines: Iterable[Sequence[str]]) -> Curve:
    """Parse a curve from its column names and the cells of its lines; empty cells are quantities that a point lacks.

    Raises:
        ValueError: a cell is not a number, a time is not finite, or a line has another number of cells.
    """
    curve = [{name: float(cell) for name, cell in zip(names, cells, strict=True) if cell} for cells in lines]
    for clock in CLOCKS:
        if not all(math.isfinite(point.get(clock, 0.0)) for point in curve):
            raise ValueError(f"{clock} holds a value that is not finite")
    return curve
