"""One HTML page out of a run folder: gathers the parts, renders the template, and keeps the page small."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from benchmark.metrics.errors_by_type import MEANINGS
from benchmark.ranking.pose_tables import HEADER, NOTES
from benchmark.ranking.standings import Entry, fields
from benchmark.ranking.table_text import seeds_in_words
from benchmark.report import leaderboard_view
from benchmark.report.comparison import OWN, Field, Find, Truths, comparisons, facts, make_field
from benchmark.report.track_panel import LIMITS, Album, Limits, Painter
from benchmark.results.run_folder import check_runs
from datagen.console.text import counted
from datagen.storage.atomic import write_atomically

LARGEST = 14_000_000
"""Bytes that a page may have; reports with many models have fewer pictures."""

TITLE = "Segmentation benchmark"


def write(folder: Path, entries: Sequence[Entry], find: Find) -> Path:
    """Make `report.html` in a run folder: self-contained, offline, and the same bytes for the same folder and data.

    Args:
        folder: The run folder.
        entries: What its tables show.
        find: Says where datasets are. Without a dataset, or without label maps, the sections that need them say so.

    Raises:
        UsageError: the folder holds no runs.
        CorruptFile: a run is damaged.
    """
    check_runs(folder)
    names = model_names(entries)
    numbers = {name: number for number, name in enumerate(names)}
    truths = Truths(find)
    titles = _track_titles(entries)
    found = [make_field(folder, members, numbers, truths, titles[_dataset(members[0])]) for members in fields(entries)]
    common = _common(found, names, numbers)
    page = b""
    for limits in LIMITS:
        page = _render(_with_pictures(common, folder, found, limits))
        if len(page) <= LARGEST:
            break
    write_atomically(folder / "report.html", page)
    return folder / "report.html"


def model_names(entries: Sequence[Entry]) -> list[str]:
    """List all models, sorted by kind, then by name."""
    kinds = list(leaderboard_view.BLOCKS)
    keys = {(kinds.index(entry.row.kind), entry.row.key.model) for entry in entries}
    return list(dict.fromkeys(name for _, name in sorted(keys)))


def _track_titles(entries: Sequence[Entry]) -> dict[tuple[str, str], str]:
    """Title of each dataset: its track, with a part of its hash if several datasets share the name."""
    datasets = {_dataset(entry) for entry in entries}
    names = [track for track, _ in datasets]
    return {(track, spec): track if names.count(track) == 1 else f"{track} {spec[:8]}" for track, spec in datasets}


def _dataset(entry: Entry) -> tuple[str, str]:
    return entry.row.key.track, entry.row.key.track_spec


def _common(found: Sequence[Field], names: Sequence[str], numbers: Mapping[str, int]) -> dict[str, Any]:
    panels = [facts(field, numbers) for field in found]
    tracks = list(dict.fromkeys(field.track for field in found))
    return {
        "title": TITLE,
        "models": names,
        "lead": f"{counted(len(names), 'model')} on {counted(len(tracks), 'track')}",
        "seeds": seeds_in_words(entry for field in found for entry in field.entries),
        "tracks": tracks,
        "fits": sorted({field.fit for field in found}, key=lambda fit: (fit != OWN, fit)),
        "panels": panels,
        "start": panels[0]["first"],
        "overviews": _overviews(found, numbers),
        "error_types": list(MEANINGS.items()),
        "pose_header": HEADER,
        "pose_notes": [note.replace("*", "") for note in NOTES],
        "comparisons": {str(place): comparisons(field, numbers) for place, field in enumerate(found)},
        "footer": _footer(found),
    }


def _with_pictures(common: Mapping[str, Any], folder: Path, found: Sequence[Field], limits: Limits) -> dict[str, Any]:
    album, galleries, panels = Album(), {}, []
    for place, (panel, field) in enumerate(zip(common["panels"], found, strict=True)):
        shown: dict[str, Any] = {"clips": [], "gallery": False}
        if field.analysis:
            ranked = [model for model in panel["first_to_last"] if model in field.analysis.rows]
            painter = Painter(folder, field.analysis, album, ranked, limits)
            galleries[str(place)] = painter.gallery()
            shown = {"clips": painter.clips(common["models"], panel["crashed"]), "gallery": True}
        panels.append({**panel, **shown})
    script = {"models": common["models"], "galleries": galleries, "comparisons": common["comparisons"]}
    return {**common, "panels": panels, "facts": script, "pictures": album.uris}


def _overviews(found: Sequence[Field], numbers: Mapping[str, int]) -> list[dict[str, Any]]:
    """MSC-FG of all models on all tracks, for each track fitted on."""
    ordered = sorted(found, key=lambda field: (field.fit != OWN, field.fit, field.track))
    return [_overview(fit, list(members), numbers) for fit, members in groupby(ordered, key=lambda field: field.fit)]


def _overview(fit: str, found: Sequence[Field], numbers: Mapping[str, int]) -> dict[str, Any]:
    scores = {(e.row.key.model, f.track): e.best_known("msc_fg") for f in found for e in f.entries}
    best = {f.track: next((e.row.key.model for e in _by_score(f) if e.is_ranked), None) for f in found}
    entries = {entry.row.key.model: entry for field in found for entry in field.entries}
    rows = []
    for model in sorted(entries, key=lambda name: numbers[name]):
        values = [scores.get((model, field.track), float("nan")) for field in found]
        cells = [
            {
                "text": leaderboard_view.number(value),
                "shade": f"{0.55 * min(max(value, 0.0), 1.0):.3f}" if value == value else "0",
                "best": best[field.track] == model,
            }
            for value, field in zip(values, found, strict=True)
        ]
        rows.append({"model": numbers[model], "marks": entries[model].marks, "cells": cells})
    title = f"fitted on {fit}"
    return {"title": title, "tracks": [field.track for field in found], "rows": rows}


def _by_score(field: Field) -> list[Entry]:
    return sorted(field.entries, key=lambda entry: -entry.best_known("msc_fg"))


def _footer(found: Sequence[Field]) -> str:
    commits = sorted({row.commit[:8] for field in found for entry in field.entries for row in entry.rows if row.commit})
    return f"Made by obpose-bench from runs of commit {', '.join(commits)}." if commits else "Made by obpose-bench."


def _render(context: Mapping[str, Any]) -> bytes:
    loader = PackageLoader("benchmark.report")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("report.html.j2").render(context).encode()
