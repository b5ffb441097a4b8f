"""Leaderboard of one track for the report. All formatting of its numbers as text and bars is in this module."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from benchmark.metrics import CLIP_METRICS, METRICS
from benchmark.ranking.number_text import plain_number
from benchmark.ranking.standings import (
    PRETRAINED,
    TUNED,
    USES_LABELS,
    Entry,
    best_first,
    best_without_training,
    in_order_of_rank,
)
from benchmark.ranking.statistics import Summary
from benchmark.ranking.table_text import rank_in_words, seeds_covered

BLOCKS = {
    "learned": "Learned",
    "predictions": "Label maps from elsewhere",
    "classical": "Classical geometry",
    "floor": "Floors: what costs nothing",
    "oracle": "Oracles: what the truth itself would reach",
}
"""Kinds of models in the order in which they are shown."""

LABELLED = "With labels"
"""Heading of models that saw labels but are neither floors nor oracles."""

NAMES = {
    "ari": "ARI",
    "ari_fg": "ARI-FG",
    "msc_fg": "MSC-FG",
    "msc_fg_allslots": "MSC-FG, all slots (mBO)",
    "miou_bg": "mIoU-BG",
    "miou_bg_oracle": "mIoU-BG†",
    "msc_fg_oracle_bg": "MSC-FG†",
    "miou_fg_hungarian": "mIoU-FG (Hungarian)",
    "ari_video": "ARI, clip",
    "ari_fg_video": "ARI-FG, clip",
    "msc_fg_video": "MSC-FG, clip",
}
"""Metrics as tables name them."""

MARKS = {
    USES_LABELS: "sees the truth, and is not ranked",
    TUNED: "tuned by scores on the validation split, which uses its labels; the number is that of values compared",
    PRETRAINED: "not trained here: one set of weights, which ships with the package or was given",
}


@dataclass(frozen=True)
class Cell:
    """A score with its interval, as text and as a bar of length 0 to 100."""

    text: str
    between: str
    length: float
    ends: tuple[float, float] | None
    letters: str
    known: bool


@dataclass(frozen=True)
class Row:
    """One model's row of the leaderboard."""

    model: int
    marks: str
    rank: str
    msc_fg: Cell
    ari_fg: Cell
    miou_bg: str
    ari: str
    time: str
    seeds: str
    failure: str
    views: str
    repeated: bool = False
    """Whether the row is a copy, shown among models that learn for comparison."""


@dataclass(frozen=True)
class Block:
    """Models of one kind, best first; the best one without training stands among those that learn, too."""

    title: str
    rows: tuple[Row, ...]


def blocks(entries: Iterable[Entry], numbers: Mapping[str, int]) -> list[Block]:
    """Build the blocks of the leaderboard; `numbers` are the models' numbers in the report."""
    entries = list(entries)
    titles = [*list(BLOCKS.values())[:3], LABELLED, *list(BLOCKS.values())[3:]]
    members = {title: [entry for entry in entries if block_title(entry) == title] for title in titles}
    return [
        Block(title, tuple(_rows(title, members[title], best_without_training(entries), numbers)))
        for title in in_order_of_rank(members)
        if members[title]
    ]


def _rows(title: str, members: Sequence[Entry], free: Entry | None, numbers: Mapping[str, int]) -> Iterator[Row]:
    """Yield the rows of a block; `free`, the best model without training, is added to those that learn."""
    repeated = [free] if free and title == BLOCKS["learned"] else []
    for entry in best_first([*members, *repeated]):
        yield replace(_row(entry, numbers), repeated=entry in repeated)


def block_title(entry: Entry) -> str:
    """Title of the block that a model belongs to."""
    labelled = entry.row.uses_labels and entry.row.kind not in ("floor", "oracle")
    return LABELLED if labelled else BLOCKS[entry.row.kind]


def details(entries: Iterable[Entry], numbers: Mapping[str, int]) -> tuple[list[str], list[dict[str, Any]]]:
    """List the metrics that any model defines, and each model's scores in them, best model first.

    A model of which only some seeds failed has a second row without these seeds.
    """
    ordered = best_first(entry for entry in entries if entry.n_scenes)
    shown = [name for name in (*METRICS, *CLIP_METRICS) if any(_defined(entry, name) for entry in ordered)]
    rows = []
    for entry in ordered:
        rows.append(_details(entry, numbers, shown, without_failed=False))
        if 0 < entry.n_failed < len(entry.rows):
            rows.append(_details(entry, numbers, shown, without_failed=True))
    return [NAMES[name] for name in shown], rows


def failures(entries: Iterable[Entry]) -> list[dict[str, str]]:
    """List the failed runs with their causes."""
    return [
        {"name": f"{row.key.model}, seed {row.key.seed}", "reason": cause}
        for entry in best_first(entries)
        for row, cause in list(zip(entry.rows, entry.causes, strict=True))[: entry.n_runs]
        if cause
    ]


def marks(entries: Sequence[Entry]) -> list[tuple[str, str]]:
    """List the marks that occur, with their meanings."""
    return [(mark, meaning) for mark, meaning in MARKS.items() if any(mark in entry.marks for entry in entries)]


def number(value: float) -> str:
    """Format a score with three decimals; a dash if it is undefined."""
    return f"{value:z.3f}".replace("-", "−") if math.isfinite(value) else "–"


def duration(seconds: float) -> str:
    """Format a time in s, ms or µs, whichever suits it."""
    for size, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")):
        if seconds >= size:
            return f"{plain_number(seconds / size, 3)} {unit}"
    return "–"


def cell(summary: Summary, letters: str = "") -> Cell:
    """Build the cell of a score with its interval; bars begin at 0."""
    known = math.isfinite(summary.mean)
    sure = math.isfinite(summary.low) and math.isfinite(summary.high)
    between = f"[{number(summary.low)}, {number(summary.high)}]" if sure else ""
    ends = (_percent(summary.low), _percent(summary.high)) if sure else None
    return Cell(number(summary.mean), between, _percent(summary.mean) if known else 0.0, ends, letters, known)


def _row(entry: Entry, numbers: Mapping[str, int]) -> Row:
    ari_fg, msc_fg = entry.groups
    return Row(
        numbers[entry.row.key.model],
        entry.marks,
        rank_in_words(entry),
        cell(entry.summary("msc_fg"), msc_fg),
        cell(entry.summary("ari_fg"), ari_fg),
        number(entry.summary("miou_bg").mean),
        number(entry.summary("ari").mean),
        duration(seconds_per_frame(entry)),
        seeds_covered(entry),
        _failure(entry),
        entry.views,
    )


def seconds_per_frame(entry: Entry) -> float:
    """Mean inference time over the finished seeds; nan if none finished."""
    times = [row.measured.seconds_per_frame for row in entry.rows if row.status == "ok"]
    return sum(times) / len(times) if times else math.nan


def _failure(entry: Entry) -> str:
    counts = Counter(cause if len(cause) < 12 else "error" for cause in entry.causes[: entry.n_runs] if cause)
    return ", ".join(f"{count} failed ({cause})" for cause, count in counts.items())


def _details(entry: Entry, numbers: Mapping[str, int], shown: Sequence[str], *, without_failed: bool) -> dict[str, Any]:
    spreads = [entry.spread(name, without_failed=without_failed) for name in shown]
    extra = "without failed seeds" if without_failed else ""
    return {"model": numbers[entry.row.key.model], "extra": extra, "cells": [_with_spread(*s) for s in spreads]}


def _with_spread(mean: float, std: float) -> str:
    return f"{number(mean)} ± {number(std)}" if math.isfinite(std) else number(mean)


def _defined(entry: Entry, metric: str) -> bool:
    return math.isfinite(entry.best_known(metric))


def _percent(value: float) -> float:
    return round(100 * min(max(value, 0.0), 1.0), 2)
