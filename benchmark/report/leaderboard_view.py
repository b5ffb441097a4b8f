"""Leaderboard of one track for the report: the columns of `benchmark.ranking.columns`, with bars for intervals."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmark.ranking import statistics
from benchmark.ranking.columns import (
    FAILED_SEEDS,
    FRACTIONAL_RANKS,
    GROUP_LETTERS,
    HEADLINE_SCORES,
    MARKS,
    RANK,
    SEEDS,
    Block,
    Row,
    Score,
    blocks,
    caveats,
    group_letters,
    marks_explained,
    paper_of_track,
    suffixes_explained,
)
from benchmark.ranking.standings import RANKED_METRICS, ModelResult
from benchmark.ranking.text import plain_number

RANKED_BLOCKS = ("learned", "predictions", "classical")
"""Blocks whose models are ranked, each block by itself."""


def leaderboard(group: Sequence[ModelResult], numbers: Mapping[str, int]) -> dict[str, Any]:
    """Build the template values of the leaderboard; `numbers` are the models' numbers in the report."""
    shown = [_block(block, numbers) for block in blocks(group)]
    paper = [
        {"name": line["paper_model"], "cells": [line.get(score.name, "") for score in HEADLINE_SCORES]}
        for line in paper_of_track(group[0].place[0]).values()
    ]
    return {"columns": [(s.heading, s.note) for s in HEADLINE_SCORES], "blocks": shown, "paper": paper}


def legend(group: Sequence[ModelResult], ranks: Iterable[str]) -> Iterator[str]:
    """Explain what occurs in the leaderboard: shared ranks, letters, marks, suffixes, failed seeds, and caveats."""
    yield f"{RANK.note} Each block is ranked by itself; leaderboard.csv ranks all blocks together."
    if any("." in rank for rank in ranks):
        yield FRACTIONAL_RANKS
    if any(letters for result in group for letters in result.group_letters):
        yield f"Letters behind a score: {GROUP_LETTERS}"
    yield from (f"{mark} {meaning}." for mark, meaning in marks_explained(group))
    yield from suffixes_explained(group)
    if any(result.n_failed for result in group):
        yield FAILED_SEEDS
    yield from caveats(group)


def details(
    group: Iterable[ModelResult], numbers: Mapping[str, int], scores: Sequence[Score]
) -> tuple[list[Score], list[dict[str, Any]]]:
    """List the scores that any model defines, and each model's values with intervals, in the leaderboard's order.

    A model of which only some seeds failed has a second row without these seeds.
    """
    rows = [row for block in blocks(group) for row in block.rows if row.result.n_scenes]
    shown = [score for score in scores if any(math.isfinite(row.result.mean(score.name)) for row in rows)]
    kept = [row for row in rows if not row.without_failed or row.result.n_failed < len(row.result.rows)]
    return shown, [
        {
            "model": numbers[row.result.row.key.model],
            "extra": "without failed seeds" if row.without_failed else row.result.views,
            "cells": [_with_interval(row, score) for score in shown],
        }
        for row in kept
    ]


def failures(group: Iterable[ModelResult]) -> list[dict[str, str]]:
    """List the failed runs with their causes."""
    rows = [row for block in blocks(group) for row in block.rows if not row.without_failed]
    failed = (failure for row in rows for failure in row.result.failures)
    return [{"name": f"{run.key.model}, seed {run.key.seed}", "reason": cause} for run, cause in failed]


def number(value: float) -> str:
    """Format a score with three decimals; a dash if it is undefined."""
    return f"{value:z.3f}".replace("-", "−") if math.isfinite(value) else "–"


def duration(seconds: float) -> str:
    """Format a time in s, ms or µs."""
    for size, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")):
        if seconds >= size:
            return f"{plain_number(seconds / size, 3)} {unit}"
    return "–"


def seconds_per_frame(result: ModelResult) -> float:
    """Mean inference time over the finished seeds; nan if none finished."""
    times = [row.measured.seconds_per_frame for row in result.rows if row.status == "ok"]
    return sum(times) / len(times) if times else math.nan


def shade(value: float, strength: float = 0.55) -> str:
    """Opacity of a table cell's background, for a value of 0 to 1."""
    return f"{strength * min(max(value, 0.0), 1.0):.3f}" if math.isfinite(value) else "0"


def _block(block: Block, numbers: Mapping[str, int]) -> dict[str, Any]:
    rows = [row for row in block.rows if not row.without_failed]
    ranks = block_ranks([row.result for row in rows]) if block.kind in RANKED_BLOCKS else [""] * len(rows)
    shown = [_row(row, rank, numbers) for row, rank in zip(rows, ranks, strict=True)]
    return {"title": block.title, "kind": block.kind, "rows": sorted(shown, key=lambda row: row["order"])}


def block_ranks(results: Sequence[ModelResult]) -> list[str]:
    """Rank models among themselves by the mean of their ranks; models that may not be ranked get an empty text."""
    ranked = [result for result in results if result.is_ranked]
    means = [np.array([result.mean(name) for result in ranked]) for name in RANKED_METRICS]
    places = iter(statistics.ranks(-statistics.mean_ranks(*means)))
    return [f"{next(places):g}" if result.is_ranked else "" for result in results]


def _row(row: Row, rank: str, numbers: Mapping[str, int]) -> dict[str, Any]:
    result = row.result
    failed = Counter(cause if len(cause) < 12 else "error" for _, cause in result.failures)
    return {
        "model": numbers[result.row.key.model],
        "order": float(rank or "inf"),
        "rank": rank,
        "overall": f"Rank {row.rank} of all models on this track" if row.rank else "not ranked",
        "marks": result.marks,
        "meaning": "; ".join(meaning for mark, meaning in MARKS.items() if mark in result.marks),
        "views": result.views,
        "scores": [_score(row, score) for score in HEADLINE_SCORES],
        "time": duration(seconds_per_frame(result)),
        "seeds": SEEDS.cell(row),
        "failure": ", ".join(f"{count} failed ({cause})" for cause, count in failed.items()),
    }


def _score(row: Row, score: Score) -> dict[str, Any]:
    """Build the cell of a score: its mean as text and as a bar of length 0 to 100, and the ends of its interval."""
    summary = row.result.summary(score.name)
    known, sure = math.isfinite(summary.mean), math.isfinite(summary.low) and math.isfinite(summary.high)
    return {
        "text": number(summary.mean),
        "between": _between(summary) if sure else "",
        "length": _percent(summary.mean) if known else 0.0,
        "ends": (_percent(summary.low), _percent(summary.high)) if sure else None,
        "letters": group_letters(row, score),
        "known": known,
    }


def _between(summary: statistics.Summary) -> str:
    return f"[{number(summary.low)}, {number(summary.high)}]"


def _with_interval(row: Row, score: Score) -> dict[str, str]:
    mean, std = row.result.score(score.name, without_failed=row.without_failed)
    summary = row.result.summary(score.name)
    sure = math.isfinite(summary.low) and not row.without_failed
    text = f"{number(mean)} ± {number(std)}" if math.isfinite(std) else number(mean)
    return {"text": text, "between": _between(summary) if sure else ""}


def _percent(value: float) -> float:
    return round(100 * min(max(value, 0.0), 1.0), 2)
