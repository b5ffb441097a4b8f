"""Coordinates stay inside the drawing, in the order of the values."""

import math

import pytest

from benchmark.report.charts import (
    BOTTOM,
    HEIGHT,
    LEFT,
    RIGHT,
    TOP,
    WIDTH,
    class_chart,
    history_chart,
    label_box,
    marker_box,
    overlap,
    place_labels,
    scatter,
    unit_y,
)


@pytest.mark.parametrize(("value", "place"), [(0.0, HEIGHT - BOTTOM), (1.0, TOP), (-0.3, HEIGHT - BOTTOM), (1.2, TOP)])
def test_scores_stand_between_bottom_and_top(value: float, place: float) -> None:
    assert unit_y(value) == place


def test_an_undefined_class_breaks_the_curve() -> None:
    chart = class_chart("t", "a", ["x", "y", "z"], [1, 0, 3], {7: [0.2, math.nan, 0.4]})
    (curve,) = chart.curves
    assert curve.model == 7
    assert curve.path.count("M") == 2
    assert len(curve.points) == 2
    assert [bar.height for bar in chart.bars] == pytest.approx([40 / 3, 0, 40], abs=0.1)


def test_learning_curves_fit_their_axes() -> None:
    chart = history_chart("loss", "step", [(0, [0.0, 10.0], [4.0, 2.0]), (1, [0.0, 20.0], [3.0, math.nan])])
    points = [(x, y) for curve in chart.curves for x, y, _ in curve.points]
    middle = LEFT + (WIDTH - LEFT - RIGHT) / 2, TOP + (HEIGHT - TOP - BOTTOM) / 2
    assert points == [(LEFT, TOP), (middle[0], HEIGHT - BOTTOM), (LEFT, middle[1])]
    assert [tick.text for tick in chart.x_ticks] == ["0", "10", "20"]


def test_a_flat_learning_curve_can_be_drawn() -> None:
    assert history_chart("loss", "step", [(0, [5.0], [1.0])]).curves[0].points


def test_costs_are_on_a_logarithmic_axis() -> None:
    chart = scatter([(i, "classical", 10.0**-i, 0.5, f"m{i}: words") for i in range(4)])
    gaps = [a.x - b.x for a, b in zip(chart.dots, chart.dots[1:], strict=False)]
    assert gaps == pytest.approx([gaps[0]] * 3, abs=0.2)
    assert [tick.text for tick in chart.x_ticks] == ["1 ms", "10 ms", "0.1 s", "1 s"]


def test_costs_of_any_size_have_names() -> None:
    chart = scatter([(i, "classical", 10.0**power, 0.5, "m: words") for i, power in enumerate((-8, 3))])
    texts = [tick.text for tick in chart.x_ticks]
    assert texts[:3] == ["0.01 µs", "0.1 µs", "1 µs"]
    assert texts[-4:] == ["1 s", "10 s", "100 s", "1000 s"]


@pytest.mark.parametrize("n", [2, 8, 25])
def test_names_cover_neither_markers_nor_one_another(n: int) -> None:
    """Also where all markers lie close together, as those of models of one family do."""
    names = [f"a-rather-long-name-{i}" for i in range(n)]
    centers = [(200.0 + 3 * (i % 3), 100.0 + 2 * i) for i in range(n)]
    labels = place_labels(centers, names, 560, 300)
    boxes = [label_box(label, name) for label, name in zip(labels, names, strict=True) if label]
    assert len(boxes) >= min(n, 8)
    for place, box in enumerate(boxes):
        assert not any(overlap(box, marker_box(*center)) for center in centers)
        assert not any(overlap(box, other) for other in boxes[:place])
        assert box[0] > LEFT
        assert box[2] < 560


def test_only_names_at_a_distance_have_a_line_to_their_marker() -> None:
    (alone,) = place_labels([(100.0, 100.0)], ["name"], 560, 300)
    assert alone
    assert alone.leader == ""
    crowd = place_labels([(100.0, 100.0 + i) for i in range(6)], ["name"] * 6, 560, 300)
    assert any(label and label.leader for label in crowd)
