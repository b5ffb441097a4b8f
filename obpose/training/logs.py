"""Logs of the training curves: CSV tables and, on request, TensorBoard."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from datagen.storage.atomic import write_atomically
from datagen.storage.safe_io import read_bytes
from obpose.errors import UsageError

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter

_MOST_BYTES = 2**30
_MOST_DIGITS = 18

Row = Mapping[str, float | int | str]


class CsvLog:
    """CSV table with a column for each name ever written; the first is `step`. Rows are written immediately.

    Raises:
        UsageError: the file is another table, which would be overwritten.
    """

    def __init__(self, path: Path, *, steps: int):
        """Resume a table after `steps` steps; rows of later steps, from after the last checkpoint, are dropped."""
        self._path = path
        rows = _rows(path, steps)
        self._columns = list(rows[0]) if rows else ["step"]
        self._rewrite(rows)

    def write(self, row: Row) -> None:
        """Append a row."""
        if new := [name for name in row if name not in self._columns]:
            self._columns += new
            self._rewrite(_rows(self._path, None))
        with self._path.open("a", newline="") as file:
            csv.DictWriter(file, self._columns, restval="").writerow(row)

    def _rewrite(self, rows: list[Row]) -> None:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, self._columns, restval="")
        writer.writeheader()
        writer.writerows(rows)
        write_atomically(self._path, text.getvalue().encode())


class TensorBoardLog:
    """TensorBoard log of the same values as the CSV tables.

    Raises:
        UsageError: TensorBoard is not installed.
    """

    def __init__(self, folder: Path, *, steps: int):
        self._writer = _writer(folder, steps)

    def write(self, group: str, row: Row) -> None:
        """Add the values of a row under a group's name."""
        step = int(row["step"])
        for name, value in row.items():
            if name != "step":
                self._writer.add_scalar(f"{group}/{name}", float(value), step)

    def close(self) -> None:
        """Flush pending values and close the log."""
        self._writer.close()


def _rows(path: Path, steps: int | None) -> list[Row]:
    """Read the complete rows of a table, up to the step `steps`; None for all."""
    if not path.exists():
        return []
    text = read_bytes(path, _MOST_BYTES).decode("utf-8", errors="replace")
    whole, _, _ = text.rpartition("\n")  # drops a last line that a kill cut short
    foreign = UsageError(f"{path} is no table of a training; it would be overwritten. Give another --out, or move it.")
    try:
        found = csv.DictReader(io.StringIO(whole))
        if text and (not whole or (found.fieldnames or [""])[0] != "step"):
            raise foreign
        return [row for row in found if _is_whole(row) and (steps is None or int(row["step"]) <= steps)]
    except csv.Error:
        raise foreign from None


def _is_whole(row: dict[str, str]) -> bool:
    """Whether a row is intact, since a crash of the machine may damage rows."""
    step = row["step"]
    return None not in row and step.isdecimal() and step.isascii() and len(step) <= _MOST_DIGITS


def _writer(folder: Path, steps: int) -> "SummaryWriter":
    try:
        from torch.utils.tensorboard.writer import SummaryWriter
    except ImportError:
        raise UsageError("TensorBoard is not installed; pip install 'obpose[tensorboard]', or leave it out.") from None
    return SummaryWriter(str(folder), purge_step=steps + 1)
