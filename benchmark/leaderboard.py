"""The table of results: one CSV file, one row for each model, dataset, split and seed."""

import csv
import io
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from benchmark.metrics import METRICS
from benchmark.runner import Result
from datagen.errors import UsageError

KEY = ("model", "version", "dataset", "spec_hash", "split", "seed")
"""What a row is of; a new result with an equal key replaces the old one."""

COUNTS = ("n_frames", "n_undefined", "n_one_object", "n_ignored")
COLUMNS = (*KEY, "scenes", *METRICS, *COUNTS, "measured_seconds_per_frame")

Row = dict[str, str]


def to_row(result: Result) -> Row:
    """A result as text, metrics with six decimals and `nan` where undefined."""
    values = {name: str(getattr(result, name)) for name in (*KEY, "scenes")}
    values |= {name: f"{result.scores[name]:.6f}" for name in METRICS}
    values |= {name: str(result.scores[name]) for name in COUNTS}
    return values | {"measured_seconds_per_frame": f"{result.seconds_per_frame:.6f}"}


def read_rows(path: Path) -> list[Row]:
    """Rows of a leaderboard; none where there is no such file yet.

    Raises:
        UsageError: the file is something else, or can never be.
    """
    if path.parent.exists() and not path.parent.is_dir():
        raise UsageError(f"{path} cannot be made: {path.parent} is not a folder; give another file with --out.")
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise UsageError(f"{path} is not a leaderboard of this version; give another file with --out, or move it.")
        return list(reader)


def update(path: Path, results: Iterable[Result]) -> None:
    """Add results to the file, each in place of an older one with the same key; readers see the old file or the new.

    Raises:
        UsageError: the file is there and is something else.
    """
    rows = {tuple(row[name] for name in KEY): row for row in read_rows(path)}
    rows |= {tuple(row[name] for name in KEY): row for row in map(to_row, results)}
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([rows[key][name] for name in COLUMNS] for key in sorted(rows))
    _replace(path, text.getvalue())


def _replace(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8", newline="") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
