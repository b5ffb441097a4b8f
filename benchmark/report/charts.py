"""Coordinates of the charts; the templates turn them into SVG."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from benchmark.ranking.text import plain_number
from datagen.console.text import counted

WIDTH, HEIGHT = 320, 208
SCATTER_SIZE = 560, 300
LEFT, RIGHT, TOP, BOTTOM = 34, 12, 12, 40
"""Margins of the plotting area, in the units of the drawing."""

MARKER = 7
"""Half the size of a marker with its outline."""
CHARACTER = 6.6
"""Upper bound of the mean width of a character."""

TALLEST_BAR = 40
"""Height of the bar of the class with most observations."""

Values = Sequence[float]


@dataclass(frozen=True)
class Tick:
    """Tick of an axis."""

    at: float
    text: str


@dataclass(frozen=True)
class Curve:
    """Curve of one model: a path for SVG, and its points."""

    model: int
    path: str
    points: tuple[tuple[float, float, str], ...]
    """Points as x, y and a description."""


@dataclass(frozen=True)
class Bar:
    """Bar for the number of observations in a class."""

    x: float
    width: float
    height: float


@dataclass(frozen=True)
class LineChart:
    """Small chart with one curve per model."""

    title: str
    axis: str
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    curves: tuple[Curve, ...]
    bars: tuple[Bar, ...] = ()


@dataclass(frozen=True)
class Label:
    """Name of a model in a scatter chart, with a line to its marker if it stands at a distance."""

    x: float
    y: float
    anchor: str
    leader: str = ""
    """Path for SVG; empty if the name stands beside its marker."""


@dataclass(frozen=True)
class Dot:
    """Marker of a model in a scatter chart."""

    model: int
    x: float
    y: float
    kind: str
    text: str
    label: Label | None
    """Place of the name, where it covers no marker and no other name; None if there is no such place."""


@dataclass(frozen=True)
class Scatter:
    """Scatter chart of quality over cost."""

    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    dots: tuple[Dot, ...]
    width: int
    height: int


def class_chart(
    title: str, axis: str, names: Sequence[str], counts: Sequence[int], values: Mapping[int, Values]
) -> LineChart:
    """Draw scores from 0 to 1 by class, with bars for the number of observations of each class."""
    step = (WIDTH - LEFT - RIGHT) / len(names)
    xs = [LEFT + step * (place + 0.5) for place in range(len(names))]
    most = max(max(counts, default=1), 1)
    bars = [
        Bar(round(x - 0.35 * step, 1), round(0.7 * step, 1), round(TALLEST_BAR * count / most, 1))
        for x, count in zip(xs, counts, strict=True)
    ]
    words = [f"{name}, {counted(count, 'observation')}" for name, count in zip(names, counts, strict=True)]
    curves = [_curve(model, xs, [unit_y(v) for v in line], line, words) for model, line in values.items()]
    every = math.ceil(len(names) / 7)
    ticks = [Tick(round(x, 1), name) for x, name in zip(xs[::every], names[::every], strict=True)]
    return LineChart(title, axis, tuple(ticks), unit_ticks(), tuple(curves), tuple(bars))


def history_chart(title: str, axis: str, lines: Sequence[tuple[int, Values, Values]]) -> LineChart:
    """Draw learning curves, given as model, times in the axis' units, and values; both axes fit the data."""
    steps = [x for _, xs, _ in lines for x in xs]
    heights = [y for _, _, ys in lines for y in ys if math.isfinite(y)]
    low_x, high_x = _span(steps)
    low_y, high_y = _span(heights)
    place_x = lambda x: LEFT + (WIDTH - LEFT - RIGHT) * (x - low_x) / (high_x - low_x)  # noqa: E731
    place_y = lambda y: HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (y - low_y) / (high_y - low_y)  # noqa: E731
    one = axis.removesuffix("s")
    curves = [
        _curve(model, [place_x(x) for x in xs], [place_y(y) for y in ys], ys, [f"{one} {plain_number(x)}" for x in xs])
        for model, xs, ys in lines
    ]
    x_ticks = [Tick(round(place_x(x), 1), plain_number(x)) for x in (low_x, (low_x + high_x) / 2, high_x)]
    y_ticks = [Tick(round(place_y(y), 1), plain_number(y, 3)) for y in (low_y, (low_y + high_y) / 2, high_y)]
    return LineChart(title, axis, tuple(x_ticks), tuple(y_ticks), tuple(curves))


def scatter(points: Sequence[tuple[int, str, float, float, str]]) -> Scatter:
    """Draw quality (0 to 1) over cost (logarithmic axis).

    Each point is (model, kind, cost, quality, words), best models first.
    """
    costs, (width, height) = [cost for _, _, cost, _, _ in points], SCATTER_SIZE
    low, high = math.floor(math.log10(min(costs))), math.ceil(math.log10(max(costs)))
    high = max(high, low + 1)
    scale = (width - LEFT - 2 * RIGHT) / (high - low)
    place = lambda cost: round(LEFT + scale * (math.log10(cost) - low), 1)  # noqa: E731
    centers = [(place(cost), unit_y(quality, height)) for _, _, cost, quality, _ in points]
    labels = place_labels(centers, [words.split(":")[0] for *_, words in points], width, height)
    dots = [
        Dot(model, x, y, kind, words, label)
        for (model, kind, _, _, words), (x, y), label in zip(points, centers, labels, strict=True)
    ]
    ticks = [Tick(place(10.0**power), _seconds(power)) for power in range(low, high + 1)]
    return Scatter(tuple(ticks), unit_ticks(height), tuple(dots), width, height)


Box = tuple[float, float, float, float]
"""Left, top, right, bottom."""


def place_labels(
    centers: Sequence[tuple[float, float]], names: Sequence[str], width: int, height: int
) -> list[Label | None]:
    """Place each name beside its marker if it covers nothing there, otherwise at the nearest free distance."""
    taken = [marker_box(*center) for center in centers]
    labels: list[Label | None] = []
    for center, name in zip(centers, names, strict=True):
        tries = ((label, label_box(label, name)) for label in _candidates(*center))
        free = (
            (label, box)
            for label, box in tries
            if box[0] > LEFT and box[2] < width and box[1] > 0 and box[3] < height - BOTTOM + MARKER
            if not any(overlap(box, other) for other in taken)
        )
        label, box = next(free, (None, None))
        labels.append(label)
        taken += [box] if box else []
    return labels


def _candidates(x: float, y: float) -> Iterator[Label]:
    """Yield places for the name of a marker, from near to far."""
    near = MARKER + 3
    yield from (Label(x + near, y + 4, "start"), Label(x - near, y + 4, "end"))
    yield from (Label(x, y - near, "middle"), Label(x, y + near + 8, "middle"))
    for distance in range(20, 150, 10):
        for dx, dy in ((1.0, -0.7), (1.0, 0.7), (-1.0, -0.7), (-1.0, 0.7), (0.3, -1.0), (0.3, 1.0), (1.0, 0.0)):
            end = x + distance * dx, y + distance * dy
            place = round(end[0] + math.copysign(3, dx), 1), round(end[1] + 4, 1)
            leader = f"M{x:.1f} {y:.1f}L{end[0]:.1f} {end[1]:.1f}"
            yield Label(*place, "start" if dx > 0 else "end", leader)


def marker_box(x: float, y: float) -> Box:
    """Area that a marker covers."""
    return x - MARKER, y - MARKER, x + MARKER, y + MARKER


def label_box(label: Label, name: str) -> Box:
    """Area that a name covers, with a margin."""
    length = CHARACTER * len(name)
    left = label.x - {"start": 0.0, "middle": 0.5, "end": 1.0}[label.anchor] * length
    return left - 1, label.y - 10, left + length + 1, label.y + 4


def overlap(a: Box, b: Box) -> bool:
    """Tell whether two areas overlap."""
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def unit_y(value: float, height: int = HEIGHT) -> float:
    """Vertical position of a score from 0 to 1; scores below 0 are drawn at 0."""
    inside = min(max(value, 0.0), 1.0) if math.isfinite(value) else math.nan
    return round(height - BOTTOM - (height - TOP - BOTTOM) * inside, 1)


def unit_ticks(height: int = HEIGHT) -> tuple[Tick, ...]:
    """Axis ticks for scores from 0 to 1."""
    return tuple(Tick(unit_y(value, height), text) for value, text in ((0.0, "0"), (0.5, "0.5"), (1.0, "1")))


def _curve(model: int, xs: Values, ys: Values, values: Values, words: Sequence[str]) -> Curve:
    path, pen = [], "M"
    for x, y in zip(xs, ys, strict=True):
        if math.isfinite(y):
            path.append(f"{pen}{x:.1f} {y:.1f}")
        pen = "L" if math.isfinite(y) else "M"
    points = [
        (round(x, 1), round(y, 1), f"{value:z.3f} at {word}")
        for x, y, value, word in zip(xs, ys, values, words, strict=True)
        if math.isfinite(y)
    ]
    return Curve(model, "".join(path), tuple(points))


def _span(values: Values) -> tuple[float, float]:
    low, high = min(values, default=0.0), max(values, default=1.0)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _seconds(power: int) -> str:
    names = {-5: "10 µs", -4: "0.1 ms", -3: "1 ms", -2: "10 ms", -1: "0.1 s"}
    if power in names:
        return names[power]
    return f"{plain_number(10.0**power)} s" if power >= 0 else f"{plain_number(10.0 ** (power + 6))} µs"
