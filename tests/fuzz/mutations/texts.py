"""Other cells in tables, and other words in texts."""

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numpy.random import Generator

from tests.fuzz.mutations.draw import pick
from tests.fuzz.mutations.json_values import NOT_UTF8, PLAIN


def change_cell(path: Path, rng: Generator) -> str:
    """Another value in the place of one cell, or lines and columns that are gone or too many."""
    rows = list(csv.reader(io.StringIO(path.read_text())))
    row = int(rng.integers(len(rows)))
    column = int(rng.integers(len(rows[row]))) if rows[row] else 0
    how = pick(rng, ("cell", "cell", "cell", "line", "twice", "longer", "shorter", "quote", "huge"))
    cells = ("", "nan", "inf", "-1", "1e999", "x", "0.5", "\0", "1_0", "10" * 50, "é\n[red]x", '"')
    edits: dict[str, Callable[[], Any]] = {
        "cell": lambda: rows[row].__setitem__(column, pick(rng, cells)),
        "line": lambda: rows.pop(row),
        "twice": lambda: rows.append(rows[row]),
        "longer": lambda: rows[row].append("1"),
        "shorter": lambda: rows[row].pop(column),
        "quote": lambda: rows[row].__setitem__(column, "QUOTE"),
        "huge": lambda: rows[row].__setitem__(column, "1" * 200_000),
    }
    if rows[row]:
        edits[how]()
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    path.write_text(text.getvalue().replace("QUOTE", '"'))
    return f"{how} at line {row + 1}, column {column + 1}"


def not_a_table(path: Path, rng: Generator) -> str:
    """Another text."""
    text = pick(rng, (b"", b"\n", b"step\n", NOT_UTF8, b"a,b\n1,2\n", path.read_bytes().splitlines()[0]))
    path.write_bytes(text)
    return f"{text[:20]!r}"


def replace_word(path: Path, rng: Generator) -> str:
    """Another word in the place of one between spaces."""
    words = path.read_text().split(" ")
    place = int(rng.integers(len(words)))
    words[place] = str(pick(rng, PLAIN))
    path.write_text(" ".join(words))
    return f"word {place + 1} by {words[place]:.20}"
