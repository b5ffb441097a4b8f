"""`learning.svg`: ARI-FG and MSC-FG on validation clips against minutes of the budget, all systems on the same axes.

A column of panels for each track; thin lines are seeds, thick ones their means. Drawn from the rows of a run folder.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float64

from benchmark.execution.validation_scores import SCORES
from benchmark.ranking.escaping import one_line
from benchmark.ranking.number_text import plain_number
from benchmark.ranking.standings import Entry, fields
from benchmark.report.leaderboard_view import NAMES
from datagen.storage.atomic import write_atomically

FILE = "learning.svg"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#7f7f00", "#8c564b", "#6a3d9a")
"""Colours that most people can distinguish (after Okabe and Ito); they repeat after the last."""
PANEL_WIDTH, PANEL_HEIGHT = 260, 170
LEFT, TOP, GAP, BELOW = 44, 26, 26, 40
LEGEND_LINE, LEGEND_COLUMN = 18, 210

Line = tuple[Float64[np.ndarray, " _"], Float64[np.ndarray, " _"]]
"""Minutes and scores."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One metric on one track."""

    title: str
    metric: str
    lines: dict[str, list[Line]]
    """Lines of each system, one per seed."""


def write(folder: Path, entries: Iterable[Entry]) -> Path | None:
    """Draw the recorded curves, and return the file's path; if there are none, delete the file and return None."""
    columns = [column for field in fields(entries) if (column := panels(field))]
    if not columns:
        (folder / FILE).unlink(missing_ok=True)
        return None
    write_atomically(folder / FILE, drawing(columns).encode())
    return folder / FILE


def panels(field: Sequence[Entry]) -> list[Panel]:
    """Panels of one track: one for each metric that some system has a curve of."""
    track, fit_track, _ = field[0].place
    title = track if fit_track == track else f"{track}, fitted on {fit_track}"
    found = [Panel(title, name, _lines(field, name)) for name in SCORES]
    return [panel for panel in found if panel.lines]


def mean_line(lines: Sequence[Line]) -> Line:
    """Mean over seeds, interpolated at the first seed's times, within the range that all seeds cover."""
    begin, end = max(minutes[0] for minutes, _ in lines), min(minutes[-1] for minutes, _ in lines)
    times = lines[0][0]
    shared = np.unique(np.clip(times, begin, max(begin, end)))
    return shared, np.mean([np.interp(shared, minutes, scores) for minutes, scores in lines], axis=0)


def drawing(columns: Sequence[Sequence[Panel]]) -> str:
    """Draw all panels as SVG: one column per track, one row per metric."""
    names = list(dict.fromkeys(name for column in columns for panel in column for name in panel.lines))
    colours = {name: COLOURS[place % len(COLOURS)] for place, name in enumerate(sorted(names))}
    width = len(columns) * (LEFT + PANEL_WIDTH) + GAP
    rows = max(map(len, columns))
    per_line = max(1, (width - LEFT) // LEGEND_COLUMN)
    legend = rows * (TOP + PANEL_HEIGHT + BELOW)
    height = legend + LEGEND_LINE * (-(-len(colours) // per_line)) + GAP
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for x, column in enumerate(columns):
        for y, panel in enumerate(column):
            place = LEFT + x * (LEFT + PANEL_WIDTH), TOP + y * (TOP + PANEL_HEIGHT + BELOW)
            parts += [f'<g transform="translate({place[0]} {place[1]})">', *_panel(panel, colours), "</g>"]
    for place, (name, colour) in enumerate(colours.items()):
        at = LEFT + (place % per_line) * LEGEND_COLUMN, legend + (place // per_line) * LEGEND_LINE + LEGEND_LINE
        parts.append(f'<path d="M{at[0]} {at[1] - 4}h24" stroke="{colour}" stroke-width="2.5"/>')
        parts.append(f'<text x="{at[0] + 30}" y="{at[1]}">{escape(one_line(name))}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _lines(field: Sequence[Entry], metric: str) -> dict[str, list[Line]]:
    found: dict[str, list[Line]] = {}
    for entry in field:
        for row in entry.rows:
            points = [point for point in row.learning_curve or () if metric in point and "seconds" in point]
            there = [point for point in points if np.isfinite(point[metric])]
            if there:
                minutes = np.array([point["seconds"] / 60 for point in there])
                found.setdefault(row.key.model, []).append((minutes, np.array([point[metric] for point in there])))
    return found


def _panel(panel: Panel, colours: dict[str, str]) -> Iterator[str]:
    last = max(float(minutes[-1]) for lines in panel.lines.values() for minutes, _ in lines)
    scale = PANEL_WIDTH / last if last > 0 else 1.0
    title = escape(one_line(panel.title))
    yield f'<text y="-8" font-weight="bold">{title}: {NAMES[panel.metric]} on validation clips</text>'
    for value in (0.0, 0.5, 1.0):
        y = PANEL_HEIGHT * (1 - value)
        yield f'<path d="M0 {y:.1f}h{PANEL_WIDTH}" stroke="#dddddd"/>'
        yield f'<text x="-6" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>'
    for share in (0.0, 0.5, 1.0):
        x = share * PANEL_WIDTH
        yield f'<text x="{x:.1f}" y="{PANEL_HEIGHT + 16}" text-anchor="middle">{plain_number(share * last, 3)}</text>'
    yield f'<text x="{PANEL_WIDTH / 2}" y="{PANEL_HEIGHT + 32}" text-anchor="middle">minutes</text>'
    for name, lines in panel.lines.items():
        for line in lines if len(lines) > 1 else []:
            yield f'<path d="{_path(line, scale)}" fill="none" stroke="{colours[name]}" opacity="0.35"/>'
        mean = _path(mean_line(lines), scale)
        title = f"<title>{escape(one_line(name))}</title>"
        yield f'<path d="{mean}" fill="none" stroke="{colours[name]}" stroke-width="2.5">{title}</path>'


def _path(line: Line, scale: float) -> str:
    """Scores under 0 stand at 0."""
    places = (
        f"{minutes * scale:.1f} {PANEL_HEIGHT * (1 - min(max(score, 0.0), 1.0)):.1f}"
        for minutes, score in zip(*line, strict=True)
    )
    return "M" + "L".join(places)
