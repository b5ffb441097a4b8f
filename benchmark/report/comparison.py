"""Comparable models, of one track and one fitting track, and their part of the report."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from benchmark.models.validation import SCORES
from benchmark.ranking.number_text import MOST_DECIMALS
from benchmark.ranking.pose_tables import pose_cells, posed
from benchmark.ranking.published import PAPER_MODELS, paper_cells
from benchmark.ranking.standings import PRETRAINED, Entry, best_first, compare_entries
from benchmark.ranking.table_text import free_of_slots, views_explained, without_floor
from benchmark.report import leaderboard_view
from benchmark.report.analysis import Analysis, analyse
from benchmark.report.charts import LineChart, Scatter, history_chart, scatter
from benchmark.report.observations import Objects, observe
from benchmark.report.track_panel import error_rows, slice_charts
from benchmark.results.csv_files import CLOCKS
from benchmark.results.scoring import SPLIT
from datagen.console.text import counted
from datagen.errors import DatagenError, UsageError
from datagen.storage.reader import Dataset, Split

OWN = "the track itself"
Find = Callable[[str, str], Path | None]
"""Function that maps a track and its hash to the dataset's folder, or None if it is not on this machine."""


@dataclass(frozen=True, eq=False)
class Field:
    """Comparable results: one track, and one track fitted on."""

    track: str
    """Name of the track, with a part of the dataset's hash if several datasets share the name."""
    fit: str
    """The track fitted on, or `OWN`."""
    entries: tuple[Entry, ...]
    """Entries, best first."""
    analysis: Analysis | None
    missing: str
    """Reason why there is no analysis; empty if there is one."""


class Truths:
    """Datasets of a report; each is read once and cached."""

    def __init__(self, find: Find):
        self._find = find
        self._known: dict[str, tuple[Split, Objects]] = {}

    def of(self, track: str, spec_hash: str) -> tuple[Split, Objects]:
        """Load the scored split of a track and its objects.

        Raises:
            UsageError: the dataset is not on this machine.
            DatagenError: the dataset cannot be read.
        """
        folder = self._find(track, spec_hash)
        if folder is None:
            raise UsageError("The dataset is not on this machine.")
        if spec_hash not in self._known:
            scenes = Dataset(folder).split(SPLIT)
            self._known[spec_hash] = scenes, observe(scenes)
        return self._known[spec_hash]


def make_field(folder: Path, entries: Sequence[Entry], numbers: Mapping[str, int], truths: Truths, title: str) -> Field:
    """Build a field; if label maps or the dataset are missing, `missing` names them."""
    key = entries[0].row.key
    fit = OWN if key.fit_track == key.track else key.fit_track
    ordered = tuple(best_first(entries))
    finished = {numbers[e.row.key.model]: [row for row in e.rows if row.status == "ok"] for e in ordered}
    try:
        scenes, objects = truths.of(key.track, key.track_spec)
        analysis = analyse(folder, scenes, objects, {model: rows for model, rows in finished.items() if rows})
        return Field(title, fit, ordered, analysis, "")
    except DatagenError as error:
        return Field(title, fit, ordered, None, f"There are no slices, errors or pictures: {error}")


def facts(field: Field, numbers: Mapping[str, int]) -> dict[str, Any]:
    """Template values of a field, without pictures."""
    entries = field.entries
    there = [numbers[entry.row.key.model] for entry in entries]
    metrics, details = leaderboard_view.details(entries, numbers)
    return {
        "track": field.track,
        "fit": field.fit,
        "subtitle": _subtitle(field),
        "models": sorted(there),
        "first": (there * 2)[:2],
        "first_to_last": there,
        "crashed": {numbers[e.row.key.model]: e.rows[0].reason for e in entries if not e.n_scenes},
        "blocks": leaderboard_view.blocks(entries, numbers),
        "paper": _paper(entries[0].row.key.track),
        "marks": leaderboard_view.marks(entries),
        "notes": [note for note in _notes(entries) if note],
        "metrics": metrics,
        "poses": [
            {"model": numbers[entry.row.key.model], "extra": entry.marks, "cells": pose_cells(entry)}
            for entry in posed(entries)
        ],
        "details": details,
        "failures": leaderboard_view.failures(entries),
        "missing": field.missing,
        "slices": slice_charts(field.analysis) if field.analysis else [],
        "errors": error_rows(field.analysis) if field.analysis else [],
        "scatter": _scatter(entries, numbers),
        "histories": _histories(entries, numbers),
        "curveless": _curveless(entries),
    }


def _notes(entries: Sequence[Entry]) -> tuple[str, ...]:
    return views_explained(entries), free_of_slots(entries), without_floor(entries)


def comparisons(field: Field, numbers: Mapping[str, int]) -> dict[str, list[float]]:
    """Paired differences in MSC-FG of any two models: mean, interval, win rate, resolvable difference, scenes."""
    scored = [entry for entry in field.entries if entry.n_scenes]
    found = {
        f"{numbers[a.row.key.model]},{numbers[b.row.key.model]}": compare_entries(a, b, "msc_fg")
        for a, b in combinations(scored, 2)
    }
    return {
        pair: [round(v, MOST_DECIMALS) for v in (d.mean, d.low, d.high, d.win_rate, d.resolvable, float(d.n_scenes))]
        for pair, d in found.items()
        if d.n_scenes > 1
    }


def _subtitle(field: Field) -> str:
    scenes = max(entry.n_scenes for entry in field.entries)
    skipped = max(entry.n_skipped for entry in field.entries)
    without = f", {skipped} of them without any object" if skipped else ""
    dataset = field.entries[0].row.key.track_spec[:8]
    return f"{counted(scenes, 'test scene')}{without}; {_fitting(field)}; dataset {dataset}."


def _fitting(field: Field) -> str:
    """Say where models were fitted; given weights were trained before the run, on this track or elsewhere."""
    given = [bool(entry.row.pretrained) for entry in field.entries]
    place = "this track" if field.fit == OWN else field.fit
    if all(given):
        return f"weights ({PRETRAINED}) trained before this run"
    return f"models fitted on {place}" + f", but for weights trained before this run ({PRETRAINED})" * any(given)


def _paper(track: str) -> list[dict[str, Any]]:
    return [
        {"name": name, "cells": cells} for model, name in PAPER_MODELS.items() if (cells := paper_cells(track, model))
    ]


def _scatter(entries: Sequence[Entry], numbers: Mapping[str, int]) -> Scatter | None:
    points = [
        (
            numbers[entry.row.key.model],
            entry.row.kind,
            seconds,
            score,
            f"{entry.row.key.model}: {leaderboard_view.number(score)}, {leaderboard_view.duration(seconds)}",
        )
        for entry in entries
        if (seconds := leaderboard_view.seconds_per_frame(entry)) > 0
        and math.isfinite(score := entry.best_known("msc_fg"))
    ]
    return scatter(points) if points else None


def _histories(entries: Sequence[Entry], numbers: Mapping[str, int]) -> list[LineChart]:
    """One chart for each quantity that some learning curve records, with a line for each seed."""
    curves = [(numbers[e.row.key.model], row.learning_curve) for e in entries for row in e.rows if row.learning_curve]
    names = dict.fromkeys(name for _, points in curves for point in points for name in point if name not in CLOCKS)
    return [_history_chart(name, curves) for name in sorted(names, key=lambda name: name not in SCORES)]


def _history_chart(name: str, curves: Sequence[tuple[int, Sequence[Mapping[str, float]]]]) -> LineChart:
    """Scores against minutes of the budget, in which models can be compared; losses, which are their own, by step."""
    if name not in SCORES:
        return history_chart(name, "step", [_history(model, points, name) for model, points in curves])
    lines = [_history(model, points, name, clock="seconds", unit=60.0) for model, points in curves]
    return history_chart(f"{leaderboard_view.NAMES[name]} on validation clips", "minutes", lines)


def _curveless(entries: Sequence[Entry]) -> str:
    """Names of models that learn and have no curve."""
    learned = [entry for entry in entries if entry.row.kind == "learned"]
    return ", ".join(e.row.key.model for e in learned if not any(row.learning_curve for row in e.rows))


def _history(
    model: int, points: Sequence[Mapping[str, float]], name: str, *, clock: str = "step", unit: float = 1.0
) -> tuple[int, list[float], list[float]]:
    there = [
        (float(point.get(clock, place)) / unit, point[name]) for place, point in enumerate(points) if name in point
    ]
    return model, [time for time, _ in there], [value for _, value in there]
