"""Paired comparison of two models of a run folder, scene by scene: `obpose-bench compare A B`."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from benchmark.ranking import statistics
from benchmark.ranking.columns import place_title, without_floor
from benchmark.ranking.standings import ALL_METRICS, ModelResult, compare_results, load_scores, unranked
from benchmark.ranking.statistics import Difference
from benchmark.ranking.text import decimals_that_show
from benchmark.results.run_folder import check_runs
from datagen.console.progress import Tracker, untracked
from datagen.console.text import counted, one_line
from datagen.errors import UsageError

COLUMNS = {"metric": 17, "A": 5, "B": 5, "A - B": 6, "95 % interval": 13, "wins": 5, "resolvable": 10, "p": 5}
"""Columns of the printed table and their widths, equal for all tracks."""

LEGEND = (
    "A - B is paired by scene, after a mean over each model's seeds that have scores. wins: share of scenes in which A "
    "scores more; equal scores count half. resolvable: the smallest true difference that these scenes would show (5 % "
    "significance, 80 % power). p: Holm-corrected over all lines; grey where 5 % or more."
)


@dataclass(frozen=True)
class Comparison:
    """Difference of model A's score from model B's, in one metric on one track."""

    track: str
    fit_tracks: tuple[str, str]
    """Tracks that A and B were fitted on."""
    metric: str
    one: float
    two: float
    """Scores of A and B: means over their seeds."""
    difference: Difference
    p_corrected: float
    """Holm-corrected for the metrics and tracks of the comparison."""
    warnings: tuple[str, ...] = ()
    """Caveats about the two models: failed seeds, undetectable collapses and missing scores."""

    @property
    def is_significant(self) -> bool:
        """Whether the difference is significant (5 %, after correction)."""
        return self.p_corrected < statistics.SIGNIFICANCE


def compare(
    folder: Path,
    one: str,
    two: str,
    metrics: Iterable[str] = ALL_METRICS,
    progress: Tracker = untracked,
    *,
    fit_track: str | None = None,
) -> list[Comparison]:
    """Compare every metric on every track on which both models have scores.

    Both were fitted on the same track. If `fit_track` is given, the first was fitted on it, and the other one on the
    track that is scored.

    Raises:
        UsageError: a model has no scores in this folder, or several results on a track, or the two have no track in
            common.
        CorruptFile: a finished row is damaged.
    """
    # Tracks on which both models have scores.
    check_runs(folder)
    everything = unranked(*load_scores(folder, progress))
    results = [result for result in everything if result.n_scenes > 0]
    first, second = (_of_model(results, name, folder) for name in (one, two))
    if fit_track is None:
        shared = [(first[place], second[place]) for place in first if place in second]
    else:
        own = {(track, data): result for (track, fitted, data), result in second.items() if fitted == track}
        there = [
            (result, own.get((track, data))) for (track, fitted, data), result in first.items() if fitted == fit_track
        ]
        shared = [(a, b) for a, b in there if b is not None]
    if not shared:
        tracks = ", ".join(sorted({track for track, *_ in first}))
        fitted = "" if fit_track is None else f", {one} fitted on {fit_track} and {two} on the track itself"
        raise UsageError(f"{one} and {two} have no track in common in {folder}{fitted}; run both on one of {tracks}.")
    # Differences on every shared track, with p-values corrected over all of them.
    wanted = [(a, b, name) for a, b in shared for name in metrics]
    found = [(*line, compare_results(*line)) for line in progress(wanted, "resampling scenes")]
    found = [line for line in found if line[3].n_scenes > 0]
    left_out = [_left_out(result) for result in everything if result.place[2] in (one, two) and result.n_scenes == 0]
    corrected = statistics.holm(np.array([line[3].p_value for line in found]))
    return [
        Comparison(
            a.place[0],
            (a.place[1], b.place[1]),
            name,
            a.mean(name),
            b.mean(name),
            difference,
            float(p_value),
            (*_warnings(a, b), *left_out),
        )
        for (a, b, name, difference), p_value in zip(found, corrected, strict=True)
    ]


def comparison_table(comparisons: Iterable[Comparison], one: str, two: str) -> Group:
    """Format comparisons for the terminal: one table per track, warnings below. Insignificant lines are grey."""
    comparisons = list(comparisons)
    places = groupby(comparisons, key=lambda line: (line.track, line.fit_tracks))
    tables = [_track_table(*place, list(lines)) for place, lines in places]
    warnings = dict.fromkeys(warning for line in comparisons for warning in line.warnings)
    return Group(
        Text(f"A = {one_line(one)}, B = {one_line(two)}\n"),
        *tables,
        *(Text(f"Warning: {one_line(warning)}", "yellow") for warning in warnings),
        LEGEND,
    )


def _track_table(track: str, fit_tracks: tuple[str, str], lines: Sequence[Comparison]) -> Table:
    scenes = max(line.difference.n_scenes for line in lines)
    first, second = fit_tracks
    place = place_title(track, first) if first == second else f"{track}, A fitted on {first} and B on {second}"
    title = Text(f"{one_line(place)}, {counted(scenes, 'scene')}", "bold")
    table = Table(title=title, title_justify="left", title_style="", box=None, pad_edge=False)
    for name, width in COLUMNS.items():
        table.add_column(name, justify="left" if name == "metric" else "right", no_wrap=True, min_width=width)
    for line in lines:
        table.add_row(*_cells(line), style=None if line.is_significant else "bright_black")
    table.add_row()
    return table


def _cells(line: Comparison) -> list[str]:
    found = line.difference
    ends = (found.mean, found.low, found.high)
    # What is significantly different from 0 must not be printed as 0.
    digits = decimals_that_show(ends if line.is_significant else (), lambda rounded, exact: bool(rounded or not exact))
    mean, low, high = (f"{value:+z.{digits}f}" for value in ends)
    return [
        line.metric,
        f"{line.one:z.3f}",
        f"{line.two:z.3f}",
        mean,
        f"{low} {high}",
        f"{100 * found.win_rate:.0f} %",
        "–" if math.isnan(found.resolvable) else f"{found.resolvable:.3f}",
        _p_value(line.p_corrected),
    ]


def _p_value(value: float) -> str:
    """Format a p-value with enough decimals to show on which side of the significance level it lies."""
    if math.isnan(value):
        return "–"
    level = statistics.SIGNIFICANCE
    digits = decimals_that_show([value], lambda rounded, exact: (rounded < level) == (exact < level))
    return f"{value:.{digits}f}" if value >= 0.001 else "<.001"


def _warnings(one: ModelResult, two: ModelResult) -> tuple[str, ...]:
    failed = ", ".join(filter(None, map(_failed_seeds, (one, two))))
    seeds = f"{place_title(*one.place[:2])}: {failed}; their scores, where they have some, count." if failed else ""
    return tuple(filter(None, (seeds, without_floor((one, two)))))


def _left_out(result: ModelResult) -> str:
    track, fit_track, model = result.place
    return f"{place_title(track, fit_track)} is left out, as {model} has no scores there: {_failed_seeds(result)}."


def _failed_seeds(result: ModelResult) -> str:
    """List the failed runs with their causes; empty if none failed."""
    return ", ".join(f"seed {row.key.seed} of {row.key.model} failed ({cause})" for row, cause in result.failures)


def _of_model(results: Iterable[ModelResult], model: str, folder: Path) -> dict[tuple[str, ...], ModelResult]:
    """Index a model's results by track, track fitted on, and dataset."""
    results = list(results)
    members = [result for result in results if result.place[2] == model]
    if not members:
        there = ", ".join(sorted({result.place[2] for result in results}))
        raise UsageError(f"{folder} has no scores of {model!r}; it has those of: {one_line(there)}.")
    found: dict[tuple[str, ...], list[ModelResult]] = {}
    for result in members:
        found.setdefault((*result.place[:2], result.row.key.track_spec), []).append(result)
    if several := next((group for group in found.values() if len(group) > 1), None):
        raise UsageError(
            f"{folder} has {len(several)} results of {model!r} on {place_title(*several[0].place[:2])}, which "
            f"differ in settings, version or data: {' and '.join(map(_seeds, several))}. Run all seeds with the same "
            "settings and --overwrite, or give a folder that holds one of these results."
        )
    return {place: group[0] for place, group in found.items()}


def _seeds(result: ModelResult) -> str:
    return f"seeds {', '.join(str(row.key.seed) for row in result.rows)}"
