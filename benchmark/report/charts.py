"""Coordinates of the charts; the templates turn them into SVG."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

WIDTH, HEIGHT = 320, 208
LEFT, RIGHT, TOP, BOTTOM = 34, 12, 12, 40
"""Margins of the plotting area, in the units of the drawing."""

Values = Sequence[float]


@dataclass(frozen=True)
class Tick:
    """A mark on an axis."""

    at: float
    text: str


@dataclass(frozen=True)
class Curve:
    """One model's line: a path for SVG, and its points."""

    model: int
    path: str
    points: tuple[tuple[float, float, str], ...]
    """x, y, and what stands there in words."""


@dataclass(frozen=True)
class Bar:
    """How many observations a class has, as a bar from the bottom."""

    x: float
    width: float
    height: float


@dataclass(frozen=True)
class LineChart:
    """A small chart of one curve a model."""

    title: str
    axis: str
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    curves: tuple[Curve, ...]
    bars: tuple[Bar, ...] = ()


@dataclass(frozen=True)
class Dot:
    """A model in a scatter chart."""

    model: int
    x: float
    y: float
    kind: str
    text: str
    labelled: bool
    """Whether no other model is both cheaper and better."""
    before: bool
    """Whether its name stands left of it, for want of room."""


@dataclass(frozen=True)
class Scatter:
    """Cost against quality."""

    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    dots: tuple[Dot, ...]
    width: int
    height: int


def class_chart(
    title: str, axis: str, names: Sequence[str], counts: Sequence[int], values: Mapping[int, Values]
) -> LineChart:
    """Scores from 0 to 1 by class, with bars that show how many observations each class has."""
    step = (WIDTH - LEFT - RIGHT) / len(names)
    xs = [LEFT + step * (place + 0.5) for place in range(len(names))]
    most = max(max(counts, default=1), 1)
    bars = [Bar(round(x - 0.35 * step, 1), round(0.7 * step, 1), round(40 * n / most, 1)) for x, n in zip(xs, counts)]
    words = [f"{name}, {count} observations" for name, count in zip(names, counts, strict=True)]
    curves = [_curve(model, xs, [unit_y(v) for v in line], line, words) for model, line in values.items()]
    every = math.ceil(len(names) / 7)
    ticks = [Tick(round(x, 1), name) for x, name in zip(xs[::every], names[::every], strict=True)]
    return LineChart(title, axis, tuple(ticks), unit_ticks(), tuple(curves), tuple(bars))


def history_chart(title: str, lines: Sequence[tuple[int, Values, Values]]) -> LineChart:
    """Learning curves: model, steps and values; both axes fit what is there."""
    steps = [x for _, xs, _ in lines for x in xs]
    heights = [y for _, _, ys in lines for y in ys if math.isfinite(y)]
    low_x, high_x = _span(steps)
    low_y, high_y = _span(heights)
    place_x = lambda x: LEFT + (WIDTH - LEFT - RIGHT) * (x - low_x) / (high_x - low_x)  # noqa: E731
    place_y = lambda y: HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (y - low_y) / (high_y - low_y)  # noqa: E731
    curves = [
        _curve(model, [place_x(x) for x in xs], [place_y(y) for y in ys], ys, [f"step {x:g}" for x in xs])
        for model, xs, ys in lines
    ]
    x_ticks = [Tick(round(place_x(x), 1), f"{x:g}") for x in (low_x, (low_x + high_x) / 2, high_x)]
    y_ticks = [Tick(round(place_y(y), 1), f"{y:.3g}") for y in (low_y, (low_y + high_y) / 2, high_y)]
    return LineChart(title, "step", tuple(x_ticks), tuple(y_ticks), tuple(curves))


def scatter(points: Sequence[tuple[int, str, float, float, str]], *, width: int = 640, height: int = 320) -> Scatter:
    """Model, kind, cost, quality from 0 to 1 and words, with the cost on a logarithmic axis."""
    costs = [cost for _, _, cost, _, _ in points]
    low, high = math.floor(math.log10(min(costs))), math.ceil(math.log10(max(costs)))
    high = max(high, low + 1)
    place = lambda cost: LEFT + (width - LEFT - RIGHT) * (math.log10(cost) - low) / (high - low)  # noqa: E731
    dots = [
        Dot(
            model,
            round(place(cost), 1),
            unit_y(quality, height),
            kind,
            words,
            not any(c <= cost and q >= quality and (c, q) != (cost, quality) for _, _, c, q, _ in points),
            place(cost) > 0.7 * width,
        )
        for model, kind, cost, quality, words in points
    ]
    ticks = [Tick(round(place(10.0**power), 1), _seconds(power)) for power in range(low, high + 1)]
    return Scatter(tuple(ticks), unit_ticks(height), tuple(dots), width, height)


def unit_y(value: float, height: int = HEIGHT) -> float:
    """Place of a score from 0 to 1; scores below 0 stand at 0."""
    inside = min(max(value, 0.0), 1.0) if math.isfinite(value) else math.nan
    return round(height - BOTTOM - (height - TOP - BOTTOM) * inside, 1)


def unit_ticks(height: int = HEIGHT) -> tuple[Tick, ...]:
    """Marks of scores from 0 to 1."""
    return tuple(Tick(unit_y(value, height), text) for value, text in ((0, "0"), (0.5, "0.5"), (1, "1")))


def _curve(model: int, xs: Values, ys: Values, values: Values, words: Sequence[str]) -> Curve:
    path, pen = [], "M"
    for x, y in zip(xs, ys, strict=True):
        if math.isfinite(y):
            path.append(f"{pen}{x:.1f} {y:.1f}")
        pen = "L" if math.isfinite(y) else "M"
    points = [
        (round(x, 1), round(y, 1), f"{value:.3f} at {word}")
        for x, y, value, word in zip(xs, ys, values, words, strict=True)
        if math.isfinite(y)
    ]
    return Curve(model, "".join(path), tuple(points))


def _span(values: Values) -> tuple[float, float]:
    low, high = min(values, default=0.0), max(values, default=1.0)
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _seconds(power: int) -> str:
    names = {-6: "1 µs", -5: "10 µs", -4: "0.1 ms", -3: "1 ms", -2: "10 ms", -1: "0.1 s", 0: "1 s", 1: "10 s"}
    return names.get(power, f"1e{power} s")
