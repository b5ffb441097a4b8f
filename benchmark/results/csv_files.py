"""Reading CSV files of a run folder, which may be damaged or come from somebody else."""

import csv
import io
from pathlib import Path

from datagen.storage.safe_io import read_text


def read_csv(path: Path) -> tuple[list[str], list[list[str]]]:
    """Read the column names and the lines of a CSV file, all of the same number of cells.

    Raises:
        ValueError: it is empty, cut short, or no table.
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
