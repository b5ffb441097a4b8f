"""Learning curves of all models as `learning.svg`: ARI-FG and MSC-FG on validation clips over minutes of training.

Each track has a column of panels. Thin lines are seeds, thick lines their means.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from benchmark.models.validation import SCORES
from benchmark.ranking.columns import HEADINGS, place_title
from benchmark.ranking.standings import ModelResult, comparable_groups
from benchmark.ranking.text import one_line, plain_number
from benchmark.report.page import environment
from datagen.storage.atomic import write_atomically

FILE = "learning.svg"
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#7f7f00", "#8c564b", "#6a3d9a")
"""Colours that most people can distinguish (after Okabe and Ito); they repeat after the last."""
PANEL_WIDTH, PANEL_HEIGHT = 260, 170

Line = tuple[Float64[np.ndarray, " _"], Float64[np.ndarray, " _"]]
"""Minutes and scores of one curve."""


@dataclass(frozen=True, eq=False)
class Panel:
    """Chart of one metric on one track."""

    title: str
    lines: dict[str, list[Line]]
    """Lines of each model, one per seed."""

    @property
    def ticks(self) -> list[tuple[float, str]]:
        """Ticks of the time axis: x and minutes."""
        return [(share * PANEL_WIDTH, plain_number(share * self._minutes, 3)) for share in (0.0, 0.5, 1.0)]

    def paths(self, model: str) -> list[str]:
        """Lines of a model as SVG paths, the mean last; scores below 0 are drawn at 0."""
        lines, scale = self.lines[model], PANEL_WIDTH / self._minutes if self._minutes > 0 else 1.0
        return [
            "M"
            + "L".join(
                f"{x * scale:.1f} {PANEL_HEIGHT * (1 - np.clip(y, 0, 1)):.1f}" for x, y in zip(*line, strict=True)
            )
            for line in [*(lines if len(lines) > 1 else []), mean_line(lines)]
        ]

    @property
    def _minutes(self) -> float:
        return max(float(minutes[-1]) for lines in self.lines.values() for minutes, _ in lines)


def write(folder: Path, results: Iterable[ModelResult]) -> Path | None:
    """Draw the recorded curves, and return the file's path; if there are none, delete the file and return None."""
    columns = [column for group in comparable_groups(results) if (column := panels(group))]
    if not columns:
        (folder / FILE).unlink(missing_ok=True)
        return None
    names = sorted({name for column in columns for panel in column for name in panel.lines})
    colours = {name: COLOURS[place % len(COLOURS)] for place, name in enumerate(names)}
    sizes = {"panel_width": PANEL_WIDTH, "panel_height": PANEL_HEIGHT, "rows": max(map(len, columns))}
    drawing = environment().get_template("learning.svg.j2").render(columns=columns, colours=colours, **sizes)
    write_atomically(folder / FILE, drawing.encode())
    return folder / FILE


def panels(group: Sequence[ModelResult]) -> list[Panel]:
    """Build the panels of one track: one for each metric of which a model has a curve."""
    title = one_line(place_title(*group[0].place[:2]))
    found = [Panel(f"{title}: {HEADINGS[name]} on validation clips", _lines(group, name)) for name in SCORES]
    return [panel for panel in found if panel.lines]


def mean_line(lines: Sequence[Line]) -> Line:
    """Mean over seeds, interpolated at the first seed's times, within the range that all seeds cover."""
    begin, end = max(minutes[0] for minutes, _ in lines), min(minutes[-1] for minutes, _ in lines)
    times = lines[0][0]
    shared = np.unique(np.clip(times, begin, max(begin, end)))
    return shared, np.mean([np.interp(shared, minutes, scores) for minutes, scores in lines], axis=0)


def _lines(group: Sequence[ModelResult], metric: str) -> dict[str, list[Line]]:
    found: dict[str, list[Line]] = {}
    for row in (row for result in group for row in result.rows):
        there = [(p["seconds"] / 60, p[metric]) for p in row.learning_curve or () if metric in p and "seconds" in p]
        if points := [point for point in there if np.isfinite(point[1])]:
            minutes, scores = np.array(points).T
            found.setdefault(one_line(row.key.model), []).append((minutes, scores))
    return found
