"""Summary tables of a run folder's edits: means with intervals, as CSV, as Markdown and on the screen."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmark.csv_files import Line, to_csv
from benchmark.names import explain_suffixes
from benchmark.ranking.statistics import Summary, draw, summarise
from benchmark.ranking.text import markdown as markdown_text
from benchmark.ranking.text import terminal
from benchmark.tasks.editing.answers import LARGEST_PSNR, METRICS
from benchmark.tasks.editing.lines import load_all
from datagen.console.text import counted
from datagen.schema import EDITS
from datagen.storage.atomic import write_atomically

FILES = ("editing.csv", "editing.md")

SHOWN = {
    "psnr_inside": "PSNR inside, dB",
    "psnr_shadow": "in shadows",
    "psnr_outside": "outside",
    "depth_inside": "depth error inside, mm",
    "depth_outside": "outside",
    "ari_fg": "ARI-FG",
    "ari": "ARI",
}
"""Headings of the metrics in tables."""

NOTES = (
    "Means over scenes with 95 % bootstrap intervals. *Inside* are pixels whose object the edit changes, *in shadows* "
    "other pixels whose colour it changes, *outside* all the rest (of depth: all but inside); a scene without such "
    f"pixels does not count there, and equal pictures have {LARGEST_PSNR:g} dB.",
    "*edit*: the model's edit against the true one. *reconstruction*: the model's picture before the edit against the "
    "true one before the edit, in the same regions; it bounds the quality of edits.",
    "*no-edit*: the true picture before the edit. *true-pixels*: the same with the true pixels of the region inside "
    "pasted in, so that only shadows are wrong. Both use ground truth.",
    "*not found*: scenes in which no label of the model has more than half of the union with the object. It cannot "
    "edit them, and its unedited picture is scored.",
)


@dataclass(frozen=True)
class Entry:
    """A row of the tables: one kind of answer on one track."""

    track: str
    edit: str
    model: str
    answer: str
    scenes: int
    not_found: int | None
    """Number of scenes in which the object was not found; None if nothing had to be found."""
    metrics: dict[str, Summary]


def write(folder: Path) -> list[Entry]:
    """Write the tables of a run folder, and return their rows."""
    entries = summaries(load_all(folder))
    texts = (to_csv([_csv_line(entry) for entry in entries]), markdown(entries))
    for name, text in zip(FILES, texts, strict=True):
        write_atomically(folder / name, text.encode())
    return entries


def summaries(lines: Sequence[Line]) -> list[Entry]:
    """Means of all answers, by track and edit."""
    ordered = sorted(lines, key=lambda line: (_place(line), line["scene"]))
    return [_entry(list(members)) for _, members in groupby(ordered, key=_place)]


def _place(line: Line) -> tuple[str, int, str, str]:
    order = [*EDITS].index(line["edit"]) if line["edit"] in EDITS else len(EDITS)
    return str(line["track"]), order, str(line["model"]), str(line["answer"])


def _entry(lines: list[Line]) -> Entry:
    values = np.array([[float(line[name]) for name in METRICS] for line in lines])
    resamples = draw(1, len(lines), np.random.default_rng(0))
    defined = (~np.isnan(values)).astype(float)
    found = [line["found"] for line in lines if line["found"]]
    first = lines[0]
    return Entry(
        track=str(first["track"]),
        edit=str(first["edit"]),
        model=str(first["model"]),
        answer=str(first["answer"]),
        scenes=len(lines),
        not_found=found.count("no") if found else None,
        metrics={
            name: summarise(values[None, :, column], defined[None, :, column], resamples)
            for column, name in enumerate(METRICS)
        },
    )


def markdown(entries: Sequence[Entry]) -> str:
    """Format one table for each track and edit, and explain the columns."""
    parts = ["# Edits against the truth\n"]
    for (track, edit), members in groupby(entries, key=lambda entry: (entry.track, entry.edit)):
        rows = list(members)
        counts = {entry.scenes for entry in rows}
        said = f", {counted(counts.pop(), 'scene')}" if len(counts) == 1 else ""
        parts.append(f"## {markdown_text(track)}: {edit}{said}\n\n{_markdown_table(rows)}\n")
    suffixes = explain_suffixes(entry.model for entry in entries)
    return "\n".join([*parts, *(f"{note}\n" for note in (*NOTES, *suffixes))])


def _markdown_table(entries: Sequence[Entry]) -> str:
    """Format one table; it has a column of scene counts if these differ between rows."""
    differ = len({entry.scenes for entry in entries}) > 1
    head = ["", *(["scenes"] if differ else []), *SHOWN.values(), "not found"]
    rows = [head, ["---"] * len(head)]
    rows += [
        [markdown_text(_label(entry)), *([str(entry.scenes)] if differ else []), *_cells(entry)] for entry in entries
    ]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def screen_table(entries: Sequence[Entry]) -> Table:
    """Format the means for the terminal."""
    table = Table("track", "edit", "picture", "scenes", *SHOWN.values(), "not found", box=None)
    for entry in entries:
        means = (_number(name, entry.metrics[name].mean) for name in METRICS)
        names = map(terminal, (entry.track, entry.edit, _label(entry)))
        table.add_row(*names, str(entry.scenes), *means, _not_found(entry))
    return table


def _label(entry: Entry) -> str:
    return entry.answer if entry.answer in ("no-edit", "true-pixels") else f"{entry.model}, {entry.answer}"


def _cells(entry: Entry) -> Iterator[str]:
    for name in METRICS:
        found = entry.metrics[name]
        yield f"{_number(name, found.mean)} ({_number(name, found.low)} to {_number(name, found.high)})"
    yield _not_found(entry)


def _not_found(entry: Entry) -> str:
    return "" if entry.not_found is None else str(entry.not_found)


def _number(name: str, value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}" if name.startswith("ari") else f"{value:.1f}"


def _csv_line(entry: Entry) -> Line:
    places = {name: getattr(entry, name) for name in ("track", "edit", "model", "answer", "scenes")}
    numbers = {
        f"{name}_{part}": getattr(entry.metrics[name], part) for name in METRICS for part in ("mean", "low", "high")
    }
    return {**places, "not_found": _not_found(entry), **numbers}
