"""The packed form of a run folder: a few compressed text files, read like the folder and never changed by runs.

DIR/
    runs.jsonl.xz ..... one line a row, ordered by name: its name and the fields of `RunRow`; or {"name": NAME,
                        "in": "../paper"} where the row is stored in another packed folder
    scenes.csv.xz ..... per-scene scores: the columns run and scene, then the others of `SceneTable`
    curves.csv.xz ..... learning curves: the column run, then their quantities; absent if there are none
    leaderboard.csv, per_seed.csv, manifest.json ..... as in an ordinary run folder
Equal tables are stored once. A row names the one whose table it shares: "scenes": "OTHER", or "../paper/OTHER" in
another packed folder; "curve" does the same for learning curves. Scores have at most six decimals, and nan is an empty
cell; learning curves are exact. `benchmark.ranking.pack` writes this form.
"""

import csv
import io
import json
import lzma
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import groupby
from pathlib import Path, PurePosixPath
from typing import Any, Literal, TypeVar

import numpy as np

from benchmark.csv_files import Curve, parse_curve
from datagen.errors import CorruptFile, UsageError
from datagen.storage.atomic import write_atomically
from datagen.storage.safe_io import MOST_TEXT_BYTES, file_version, parse_json, read_bytes

ROWS_FILE, SCENES_FILE, CURVES_FILE = "runs.jsonl.xz", "scenes.csv.xz", "curves.csv.xz"
DECIMALS = 6
"""Decimals of stored scores."""
MOST_MEMORY = 2**27
"""Bytes that the decompressor may use."""
_FILTERS = ({"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, "dict_size": 2**24},)

Columns = dict[str, np.ndarray]
"""Column name to float64 array over the lines of a table."""
Fields = dict[str, Any]
"""A line of `runs.jsonl.xz`."""
Part = Literal["scenes", "curve"]
"""Part of a row that may be shared with another row."""
Stored = TypeVar("Stored", Columns, Curve)
Parsed = TypeVar("Parsed")


def is_packed(folder: Path) -> bool:
    """Tell whether a folder holds packed runs."""
    return (folder / ROWS_FILE).exists()


def refuse_packed(folder: Path) -> None:
    """Check that runs may write to a folder.

    Raises:
        UsageError: it holds packed runs.
    """
    if is_packed(folder):
        raise UsageError(
            f"{folder} holds packed results, which are read-only. Write to another folder; to add its rows to these, "
            f"run: obpose-bench pack FOLDER --out {folder}"
        )


def packed_rows(folder: Path) -> Iterator[Fields]:
    """Yield the fields of every row, `name` and `learning_curve` included, ordered by name.

    Raises:
        CorruptFile: a file is damaged or missing.
    """
    for name in stored_rows(folder):
        place, row = _resolve(folder, name)
        yield {**row, "learning_curve": _curve(place, row)}


def packed_scenes(folder: Path, name: str) -> Columns:
    """Per-scene scores of one row.

    Raises:
        CorruptFile: a file is damaged or missing, or does not have these scores.
    """
    place, owner = owner_of(*_resolve(folder, name), "scenes")
    if (table := stored_scenes(place).get(owner)) is None:
        raise _damaged(place / SCENES_FILE, f"it has no scores of {owner}")
    return dict(table)


def _curve(folder: Path, row: Fields) -> Curve | None:
    place, owner = owner_of(folder, row, "curve")
    curve = stored_curves(place).get(owner)
    if curve is None and "curve" in row:
        raise _damaged(place / CURVES_FILE, f"it has no curve of {owner}")
    return curve


def _resolve(folder: Path, name: str) -> tuple[Path, Fields]:
    """Find the folder and the line that store a row, at most one reference away."""
    row = stored_rows(folder).get(name)
    if row is not None and "in" in row:
        folder = _follow(folder, row["in"])
        row = stored_rows(folder).get(name)
    if row is None or "in" in row:
        raise _damaged(folder / ROWS_FILE, f"it does not store the row {name}")
    return folder, row


def owner_of(folder: Path, row: Fields, part: Part) -> tuple[Path, str]:
    """Find the folder and the name under which a part of a stored row is kept."""
    place, _, name = str(row.get(part, row["name"])).rpartition("/")
    return (_follow(folder, place) if place else folder), name


def _follow(folder: Path, relative: object) -> Path:
    """Resolve a reference from one packed folder to another."""
    if not isinstance(relative, str) or "\0" in relative or PurePosixPath(relative).is_absolute():
        raise _damaged(folder / ROWS_FILE, f"it refers to {relative!r:.80}; expected a relative path")
    other = folder / relative
    if not is_packed(other):
        raise CorruptFile(
            f"{folder / ROWS_FILE} refers to rows in {other}, which holds none. Keep folders that belong together in "
            "one place, such as all of docs/results."
        )
    return other


def stored_rows(folder: Path) -> dict[str, Fields]:
    """Load the lines of `runs.jsonl.xz` by name, without following references.

    Raises:
        CorruptFile: the file is damaged or missing.
    """
    return _load(folder / ROWS_FILE, _parse_rows)


def stored_scenes(folder: Path) -> dict[str, Columns]:
    """Load all tables of `scenes.csv.xz` by name; none if the file is absent."""
    return _tables(folder / SCENES_FILE, _columns)


def stored_curves(folder: Path) -> dict[str, Curve]:
    """Load all curves of `curves.csv.xz` by name; none if the file is absent."""
    return _tables(folder / CURVES_FILE, parse_curve)


def _tables(path: Path, parse: Callable[[Sequence[str], list[list[str]]], Stored]) -> dict[str, Stored]:
    return _load(path, _parse_tables, parse) if path.exists() else {}


def _load(path: Path, parse: Callable[..., Parsed], *arguments: Any) -> Parsed:
    """Parse a file, or return the cached result if the file has not changed."""
    return _load_version(path, file_version(path), parse, *arguments)


@lru_cache(maxsize=48)
def _load_version(path: Path, _version: tuple[int, ...] | None, parse: Callable[..., Any], *arguments: Any) -> Any:
    return parse(path, *arguments)


def _parse_rows(path: Path) -> dict[str, Fields]:
    rows: dict[str, Fields] = {}
    for number, line in enumerate(filter(None, unpacked(path).split("\n")), start=1):
        try:
            row = parse_json(line)
        except ValueError as error:
            raise _damaged(path, f"line {number}: {error}") from None
        if not isinstance(row, dict) or not isinstance(row.get("name"), str) or row["name"] in rows:
            raise _damaged(path, f"line {number} has no name of its own")
        rows[row["name"]] = row
    return rows


def _parse_tables(path: Path, parse: Callable[[Sequence[str], list[list[str]]], Stored]) -> dict[str, Stored]:
    """Parse all tables of a file, one for each name in its first column."""
    found: dict[str, Stored] = {}
    try:
        lines = csv.reader(io.StringIO(unpacked(path), newline=""), strict=True)
        first, *names = next(lines, [""])
        if first != "run" or len(set(names)) != len(names):
            raise ValueError("its first line is not a header that begins with run")
        for name, members in groupby(lines, key=lambda line: "".join(line[:1])):
            if name in found:
                raise ValueError(f"the lines of {name} are in two places")
            found[name] = parse(names, [cells for _, *cells in members])
    except (ValueError, csv.Error) as error:
        raise _damaged(path, error) from None
    return found


def _columns(names: Sequence[str], lines: list[list[str]]) -> Columns:
    """Parse the scores of one row; columns without values, and without counts of values in NAME_n, are left out."""
    if any(len(cells) != len(names) for cells in lines):
        raise ValueError(f"a line has another number of columns than the header, {len(names)}")
    # `float` parses texts several times as fast as NumPy does.
    numbers = [float(cell) if cell else math.nan for cells in lines for cell in cells]
    values = np.array(numbers).reshape(len(lines), len(names))
    filled = {name for name, column in zip(names, values.T, strict=True) if not np.isnan(column).all()}
    return {name: values[:, place] for place, name in enumerate(names) if {name, f"{name}_n"} & filled}


def unpacked(path: Path, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """Read an xz-compressed UTF-8 text of limited size.

    Raises:
        CorruptFile: the file is missing, damaged, or longer than `most_bytes` once it is decompressed.
    """
    try:
        decompressor = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=MOST_MEMORY)
        text = decompressor.decompress(read_bytes(path), max_length=most_bytes + 1)
        if len(text) > most_bytes:
            raise ValueError(f"it holds more than {most_bytes:,} bytes of text")
        if not decompressor.eof or decompressor.unused_data:
            raise ValueError("it is cut short, or something follows its end")
        return text.decode("utf-8")
    except (OSError, EOFError, lzma.LZMAError, ValueError) as error:
        raise _damaged(path, error) from None


def write_rows(folder: Path, rows: Iterable[Fields]) -> None:
    """Write `runs.jsonl.xz`, ordered by name."""
    lines = (json.dumps(row, allow_nan=False, default=str) for row in sorted(rows, key=lambda row: row["name"]))
    _write(folder / ROWS_FILE, "".join(f"{line}\n" for line in lines))


def write_scenes(folder: Path, tables: Mapping[str, Columns]) -> None:
    """Write `scenes.csv.xz`, ordered by name."""
    lines = {
        name: [dict(zip(table, map(score_text, values), strict=True)) for values in zip(*table.values(), strict=True)]
        for name, table in tables.items()
    }
    _write_tables(folder / SCENES_FILE, lines)


def write_curves(folder: Path, curves: Mapping[str, Curve]) -> None:
    """Write `curves.csv.xz`, ordered by name, with exact floats."""
    lines = {
        name: [{key: repr(float(value)) for key, value in point.items()} for point in curve]
        for name, curve in curves.items()
    }
    _write_tables(folder / CURVES_FILE, lines)


def _write_tables(path: Path, tables: Mapping[str, Sequence[Mapping[str, str]]]) -> None:
    """Write the lines of all tables below each other, with the columns of all; without tables, write no file."""
    if not tables:
        return
    names = list(dict.fromkeys(column for name in sorted(tables) for line in tables[name] for column in line))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["run", *names])
    for name in sorted(tables):
        writer.writerows([name, *(line.get(column, "") for column in names)] for line in tables[name])
    _write(path, text.getvalue())


def score_text(value: float) -> str:
    """Format a score with at most `DECIMALS` decimals; nan is an empty text.

    >>> [score_text(value) for value in (0.5, 3.0, -1e-9, 0.12345678, math.nan)]
    ['0.5', '3', '0', '0.123457', '']
    """
    return "" if math.isnan(value) else f"{value:z.{DECIMALS}f}".rstrip("0").rstrip(".")


def _write(path: Path, text: str) -> None:
    """Compress a text into a file, unless it holds the text already; equal texts give equal bytes."""
    data = text.encode()
    if len(data) > MOST_TEXT_BYTES:
        raise UsageError(
            f"{path} would hold {len(data):,} bytes of text, more than {MOST_TEXT_BYTES:,}. Pack fewer runs."
        )
    if not path.exists() or unpacked(path) != text:
        write_atomically(path, lzma.compress(data, lzma.FORMAT_XZ, filters=_FILTERS))


def _damaged(path: Path, reason: object) -> CorruptFile:
    return CorruptFile(f"{path} is damaged ({reason!s:.200}). Get it again from where it was published.")
