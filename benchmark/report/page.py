"""One HTML page out of a run folder: gathers the parts, renders the template, and keeps the page small."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from benchmark.errors_by_type import MEANINGS
from benchmark.files import write_whole
from benchmark.report import board
from benchmark.report.analysis import Analysis, analyse, observe_split, open_split
from benchmark.report.charts import LineChart, Scatter, history_chart, scatter
from benchmark.report.panel import LIMITS, Album, Limits, Painter, error_rows, shades, slice_charts
from benchmark.results import RunRow, check_runs
from benchmark.standings import Entry, best_first, compare_entries, fields, load_standings
from datagen.errors import DatagenError

LARGEST = 14_000_000
"""Bytes that a page may have; reports with many models have fewer pictures."""

OWN = "the track itself"

Data = Callable[[str], Path | None] | Mapping[str, Path | None]
"""Folder of each track's dataset, or None where it is not at hand."""


@dataclass(frozen=True, eq=False)
class Field:
    """Models that are compared with one another: one track, one way of fitting."""

    track: str
    fit: str
    entries: tuple[Entry, ...]
    """Best first."""
    analysis: Analysis | None
    missing: str
    """Why there is no analysis."""


def write(folder: Path, data: Data) -> Path:
    """Make `report.html` in a run folder: self-contained, offline, and the same bytes for the same folder and data.

    Args:
        folder: The run folder.
        data: Where the datasets of the tracks are; without them, or without label maps, the sections that need pictures
            say so.

    Raises:
        UsageError: the folder holds no runs.
        CorruptFile: a run is damaged.
    """
    check_runs(folder)
    find = data if callable(data) else data.get
    found = [_field(folder, list(members), find) for members in fields(load_standings(folder))]
    common = _common(found)
    path = folder / "report.html"
    for limits in LIMITS:
        page = _render(common | _pictures(folder, found, limits, common["numbers"]))
        if len(page) <= LARGEST:
            break
    write_whole(path, page)
    return path


def _field(folder: Path, entries: Sequence[Entry], find: Callable[[str], Path | None]) -> Field:
    key = entries[0].row.key
    fit = OWN if key.fit_track == key.track else key.fit_track
    ordered = tuple(best_first(entries))
    ...


def _common(found: Sequence[Field]) -> dict[str, Any]: ...
