"""One HTML page for a run folder: gathers the parts, renders the template, and limits the size of the page."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from benchmark.metrics.errors_by_type import MEANINGS
from benchmark.ranking.columns import BLOCKS, POSE_NOTES, POSE_SCORES, SEEDS, kind_of, seeds_in_words
from benchmark.ranking.standings import ModelResult, comparable_groups
from benchmark.report import leaderboard_view
from benchmark.report.gallery import LIMITS, Album, Limits, Painter
from benchmark.report.track import OWN, Datasets, Find, TrackResults, comparisons, facts, load_track
from benchmark.results.run_folder import check_runs
from datagen.console.text import counted
from datagen.storage.atomic import write_atomically

REPORT = "report.html"
"""File name of the report of a run folder."""
LARGEST = 14_000_000
"""Largest size of a page in bytes; reports with many models have fewer pictures."""

TITLE = "ObPose segmentation benchmark"


def write(
    folder: Path,
    results: Sequence[ModelResult],
    find: Find,
    *,
    command: str = "",
    date: str = "",
    largest: int = LARGEST,
) -> Path:
    """Write `report.html` into a run folder: self-contained, offline, and the same bytes for the same arguments.

    The command that made the results and the date are shown at the top. A page larger than `largest` bytes gets fewer
    pictures. Without a dataset, or without label maps, the sections that need them say so.

    Raises:
        UsageError: the folder holds no runs.
        CorruptFile: a run is damaged.
    """
    check_runs(folder)
    names = model_names(results)
    numbers = {name: number for number, name in enumerate(names)}
    datasets, titles = Datasets(find), _track_titles(results)
    groups = comparable_groups(results)
    tracks = [load_track(folder, group, numbers, datasets, titles[_dataset(group[0])]) for group in groups]
    common = {**_common(tracks, names, numbers), "command": command, "date": date}
    template, page = environment().get_template("report.html.j2"), b""
    for limits in LIMITS:
        page = template.render(_with_pictures(common, folder, tracks, limits)).encode()
        if len(page) <= largest:
            break
    write_atomically(folder / REPORT, page)
    return folder / REPORT


def model_names(results: Sequence[ModelResult]) -> list[str]:
    """List all models, sorted by kind, then by name."""
    kinds = list(BLOCKS)
    keys = {(kinds.index(kind_of(result)), result.row.key.model) for result in results}
    return list(dict.fromkeys(name for _, name in sorted(keys)))


def _track_titles(results: Sequence[ModelResult]) -> dict[tuple[str, str], str]:
    """Title of each dataset: its track, with a part of its hash if several datasets share the name."""
    datasets = {_dataset(result) for result in results}
    names = [track for track, _ in datasets]
    return {(track, spec): track if names.count(track) == 1 else f"{track} {spec[:8]}" for track, spec in datasets}


def _dataset(result: ModelResult) -> tuple[str, str]:
    return result.row.key.track, result.row.key.track_spec


def _common(tracks: Sequence[TrackResults], names: Sequence[str], numbers: Mapping[str, int]) -> dict[str, Any]:
    """Template values that do not depend on the number of pictures."""
    panels = [facts(track, numbers) for track in tracks]
    titles = list(dict.fromkeys(track.track for track in tracks))
    rows = [row for track in tracks for result in track.results for row in result.rows]
    return {
        "title": TITLE,
        "models": names,
        "lead": f"{counted(len(names), 'model')} on {counted(len(titles), 'track')}",
        "seeds": seeds_in_words(result for track in tracks for result in track.results),
        "tracks": titles,
        "fits": sorted({track.fit for track in tracks}, key=lambda fit: (fit != OWN, fit)),
        "panels": panels,
        "start": panels[0]["first"],
        "overviews": list(_overviews(tracks, numbers)) if len(tracks) > 1 else [],
        "error_types": list(MEANINGS.items()),
        "pose_header": [column.heading for column in (SEEDS, *POSE_SCORES)],
        "pose_notes": [note.replace("*", "") for note in POSE_NOTES],
        "comparisons": {str(place): comparisons(track, numbers) for place, track in enumerate(tracks)},
        "commits": sorted({row.commit[:8] for row in rows if row.commit}),
    }


def _with_pictures(
    common: Mapping[str, Any], folder: Path, tracks: Sequence[TrackResults], limits: Limits
) -> dict[str, Any]:
    """Add the pictures to the template values, and the values that the page's script reads."""
    album, galleries = Album(), {}
    for place, (panel, track) in enumerate(zip(common["panels"], tracks, strict=True)):
        if track.analysis:
            order = [model for model in panel["ordered"] if model in track.analysis.rows]
            gallery = Painter(folder, track.analysis, album, order, limits).gallery(order)
            galleries[str(place)] = {**gallery, "crashed": panel["crashed"]}
    script = {"models": common["models"], "galleries": galleries, "comparisons": common["comparisons"]}
    return {**common, "facts": script, "pictures": album.uris}


def _overviews(tracks: Sequence[TrackResults], numbers: Mapping[str, int]) -> Iterator[dict[str, Any]]:
    """Yield a table of the MSC-FG of all models on all tracks, for each track fitted on."""
    ordered = sorted(tracks, key=lambda track: (track.fit != OWN, track.fit, track.track))
    for fit, found in groupby(ordered, key=lambda track: track.fit):
        members = list(found)
        marks = {numbers[r.row.key.model]: r.marks for track in members for r in track.results}
        columns = [_overview_column(track, numbers) for track in members]
        empty = {"text": "–", "shade": "0", "best": False}
        rows = [
            {"model": model, "marks": marks[model], "cells": [column.get(model, empty) for column in columns]}
            for model in sorted(marks)
        ]
        yield {"title": f"fitted on {fit}", "tracks": [track.track for track in members], "rows": rows}


def _overview_column(track: TrackResults, numbers: Mapping[str, int]) -> dict[int, dict[str, Any]]:
    """Cells of a track by model; the best ranked model is marked."""
    best = max((result.mean("msc_fg") for result in track.results if result.is_ranked), default=float("nan"))
    means = {numbers[result.row.key.model]: (result.mean("msc_fg"), result.is_ranked) for result in track.results}
    return {
        model: {
            "text": leaderboard_view.number(mean),
            "shade": leaderboard_view.shade(mean),
            "best": is_ranked and mean == best,
        }
        for model, (mean, is_ranked) in means.items()
    }


def environment() -> Environment:
    """Load the templates of the report."""
    loader = PackageLoader("benchmark.report")
    options: dict[str, Any] = {"undefined": StrictUndefined, "trim_blocks": True, "lstrip_blocks": True}
    return Environment(loader=loader, autoescape=True, **options)
