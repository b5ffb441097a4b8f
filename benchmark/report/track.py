"""The part of the report on one track: comparable results, and their template values."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

from benchmark.csv_files import CLOCKS
from benchmark.models.validation import SCORES
from benchmark.names import base_name
from benchmark.ranking.columns import HEADINGS, OTHER_SCORES, POSE_SCORES, SEEDS, scenes_title, with_poses
from benchmark.ranking.columns import SCORES as ALL_SCORES
from benchmark.ranking.standings import PRETRAINED, ModelResult, best_first, compare_results
from benchmark.ranking.text import MOST_DECIMALS
from benchmark.report import leaderboard_view
from benchmark.report.analysis import Analysis, analyse
from benchmark.report.charts import LineChart, Scatter, class_chart, history_chart, scatter
from benchmark.report.observations import Objects, observe
from benchmark.report.slices import Missing, slicings
from benchmark.results.scoring import SPLIT
from datagen.errors import DatagenError, UsageError
from datagen.storage.reader import Dataset, Split

OWN = "the track itself"
METRIC_TABLES = {"All metrics": ALL_SCORES, "Metrics of other benchmarks": OTHER_SCORES}
"""Collapsed tables of the section on metrics, by title."""
Find = Callable[[str, str], Path | None]
"""Function that maps a track and its hash to the dataset's folder, or None if it is not on this machine."""


@dataclass(frozen=True, eq=False)
class TrackResults:
    """Comparable results: one track, and one track fitted on."""

    track: str
    """Name of the track, with a part of the dataset's hash if several datasets share the name."""
    fit: str
    """The track fitted on, or `OWN`."""
    results: tuple[ModelResult, ...]
    """Results, best first."""
    analysis: Analysis | None
    missing: str
    """Reason why there is no analysis; empty if there is one."""


class Datasets:
    """Datasets of a report; each is read once and cached."""

    def __init__(self, find: Find):
        self._find = find
        self._known: dict[str, tuple[Split, Objects]] = {}

    def load(self, track: str, spec_hash: str) -> tuple[Split, Objects]:
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


def load_track(
    folder: Path, group: Sequence[ModelResult], numbers: Mapping[str, int], datasets: Datasets, title: str
) -> TrackResults:
    """Analyse comparable results; if label maps or the dataset are missing, `missing` names them."""
    key = group[0].row.key
    fit = OWN if key.fit_track == key.track else key.fit_track
    ordered = tuple(best_first(group))
    finished = {numbers[r.row.key.model]: [row for row in r.rows if row.status == "ok"] for r in ordered}
    try:
        scenes, objects = datasets.load(key.track, key.track_spec)
        analysis = analyse(folder, scenes, objects, {model: rows for model, rows in finished.items() if rows})
        return TrackResults(title, fit, ordered, analysis, "")
    except DatagenError as error:
        return TrackResults(title, fit, ordered, None, f"There are no slices, errors or pictures: {error}")


def facts(track: TrackResults, numbers: Mapping[str, int]) -> dict[str, Any]:
    """Template values of a track, without pictures."""
    results = track.results
    table = leaderboard_view.leaderboard(results, numbers)
    ranks = [row["rank"] for block in table["blocks"] for row in block["rows"]]
    ordered = [row["model"] for block in table["blocks"] for row in block["rows"]]
    tables = [(title, *leaderboard_view.details(results, numbers, scores)) for title, scores in METRIC_TABLES.items()]
    return {
        "track": track.track,
        "fit": track.fit,
        "subtitle": f"{scenes_title(results)}; {_fitting(track)}",
        "models": sorted(ordered),
        "ordered": ordered,
        "first": _first(ordered, {number: name for name, number in numbers.items()}),
        "crashed": {numbers[result.row.key.model]: result.rows[0].reason for result in results if not result.n_scenes},
        "table": table,
        "legend": list(leaderboard_view.legend(results, ranks)),
        "metrics": [
            {"title": title, "columns": [(score.heading, score.note) for score in found], "rows": rows}
            for title, found, rows in tables
            if found
        ],
        "poses": [
            {
                "model": numbers[row.result.row.key.model],
                "extra": row.result.marks,
                "cells": [column.cell(row) for column in (SEEDS, *POSE_SCORES)],
            }
            for row in with_poses(results)
        ],
        "failures": leaderboard_view.failures(results),
        "missing": track.missing,
        "slices": _slice_charts(track.analysis) if track.analysis else [],
        "errors": _error_rows(track.analysis) if track.analysis else [],
        "scatter": _scatter(results, numbers),
        "histories": _histories(results, numbers),
        "curveless": _curveless(results),
    }


def _first(ordered: Sequence[int], names: Mapping[int, str]) -> list[int]:
    """Choose the two models that the page compares first: the best rows of different models, if there are any."""
    best = {base_name(names[model]): model for model in reversed(ordered)}
    others = [model for model in ordered if model in best.values()]
    return ([*others, *(model for model in ordered if model not in others)] * 2)[:2]


def comparisons(track: TrackResults, numbers: Mapping[str, int]) -> dict[str, list[float]]:
    """Paired differences in MSC-FG of any two models: mean, interval, win rate, resolvable difference, scenes."""
    scored = [result for result in track.results if result.n_scenes]
    found = {
        f"{numbers[a.row.key.model]},{numbers[b.row.key.model]}": compare_results(a, b, "msc_fg")
        for a, b in combinations(scored, 2)
    }
    return {
        pair: [round(v, MOST_DECIMALS) for v in (d.mean, d.low, d.high, d.win_rate, d.resolvable, float(d.n_scenes))]
        for pair, d in found.items()
        if d.n_scenes > 1
    }


def _fitting(track: TrackResults) -> str:
    """Name the track that models were fitted on; given weights were trained before the run."""
    given = [bool(result.row.pretrained) for result in track.results]
    place = "this track" if track.fit == OWN else track.fit
    if all(given):
        return f"weights ({PRETRAINED}) trained before this run"
    return f"models fitted on {place}" + f", except weights trained before this run ({PRETRAINED})" * any(given)


def _slice_charts(analysis: Analysis) -> list[LineChart | Missing]:
    """Draw one chart for each slicing, with a curve for each model."""
    charts: list[LineChart | Missing] = []
    for slicing in slicings(analysis.objects):
        if isinstance(slicing, Missing):
            charts.append(slicing)
            continue
        curves = {model: slicing.means(outcome.overlap).tolist() for model, outcome in analysis.means.items()}
        charts.append(class_chart(slicing.title, slicing.axis, slicing.names, slicing.counts.tolist(), curves))
    return charts


def _error_rows(analysis: Analysis) -> list[dict[str, Any]]:
    """Build the table of errors: the share of all objects in all images that suffer each type, by model."""
    rows = []
    for model, outcome in analysis.means.items():
        shares = outcome.errors.mean(axis=0).tolist()
        texts = [f"{100 * share:.1f}%" if 0 < share < 1 else f"{100 * share:.0f}%" for share in shares]
        shades = [leaderboard_view.shade(share) for share in shares]
        rows.append({"model": model, "cells": list(zip(texts, shades, strict=True))})
    return rows


def _scatter(results: Sequence[ModelResult], numbers: Mapping[str, int]) -> Scatter | None:
    points = []
    for result in results:
        seconds, score = leaderboard_view.seconds_per_frame(result), result.mean("msc_fg")
        if seconds > 0 and math.isfinite(score):
            name = result.row.key.model
            words = f"{name}: {leaderboard_view.number(score)}, {leaderboard_view.duration(seconds)}"
            points.append((numbers[name], result.row.kind, seconds, score, words))
    return scatter(points) if points else None


def _histories(results: Sequence[ModelResult], numbers: Mapping[str, int]) -> list[LineChart]:
    """Draw one chart for each quantity that a learning curve records, with a line for each seed."""
    curves = [(numbers[r.row.key.model], row.learning_curve) for r in results for row in r.rows if row.learning_curve]
    names = dict.fromkeys(name for _, points in curves for point in points for name in point if name not in CLOCKS)
    return [_history_chart(name, curves) for name in sorted(names, key=lambda name: name not in SCORES)]


def _history_chart(name: str, curves: Sequence[tuple[int, Sequence[Mapping[str, float]]]]) -> LineChart:
    """Draw scores over minutes, which compares models; draw losses, which differ between models, over steps."""
    clock, unit = ("seconds", 60.0) if name in SCORES else ("step", 1.0)
    lines = []
    for model, points in curves:
        there = [(point.get(clock, place) / unit, point[name]) for place, point in enumerate(points) if name in point]
        lines.append((model, [time for time, _ in there], [value for _, value in there]))
    title = f"{HEADINGS[name]} on validation clips" if name in SCORES else name
    return history_chart(title, "minutes" if name in SCORES else "step", lines)


def _curveless(results: Sequence[ModelResult]) -> str:
    """List the learned models without a learning curve."""
    learned = [result for result in results if result.row.kind == "learned"]
    return ", ".join(r.row.key.model for r in learned if not any(row.learning_curve for row in r.rows))
