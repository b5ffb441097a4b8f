import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.metrics.box_overlap import Box, box_corners, box_overlap

CUBE: Box = (np.zeros(3), np.eye(3), np.ones(3))
OCTAGON = 2 * (np.sqrt(2) - 1)
"""Area that a unit square shares with itself turned by 45 degrees."""


def box(
    center: tuple[float, float, float] = (0, 0, 0), size: tuple[float, float, float] = (1, 1, 1), turn: object = None
):
    rotation = np.eye(3) if turn is None else Rotation.from_rotvec(turn).as_matrix()
    return np.array(center, float), rotation, np.array(size, float)


def some_box(rng: np.random.Generator) -> Box:
    return rng.uniform(-0.3, 0.3, 3), Rotation.random(random_state=rng).as_matrix(), rng.uniform(0.4, 1.2, 3)


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (box(), 1.0),
        (box((0.5, 0, 0)), 1 / 3),
        (box((0.5, 0.5, 0.5)), 1 / 15),
        (box(size=(0.5, 0.5, 0.5)), 1 / 8),
        (box(turn=(0, 0, np.pi / 4)), OCTAGON / (2 - OCTAGON)),
        (box(turn=(0, np.pi / 2, 0)), 1.0),
        (box((1.0, 0, 0)), 0.0),
        (box((3, 0, 0)), 0.0),
        (box((0.9, 0.9, 0), turn=(0, 0, np.pi / 4)), 0.0),
        (box(size=(1, 1, 0)), 0.0),
    ],
)
def test_what_geometry_says(other: Box, expected: float):
    assert box_overlap(CUBE, other) == pytest.approx(expected, abs=1e-7)
    assert box_overlap(other, CUBE) == pytest.approx(expected, abs=1e-7)


def test_boxes_without_volume_share_nothing():
    point = box(size=(0, 0, 0))
    assert box_overlap(point, point) == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_it_is_what_counting_points_gives(seed: int):
    rng = np.random.default_rng(seed)
    one, other = some_box(rng), some_box(rng)
    points = rng.uniform(-1.5, 1.5, (400_000, 3))
    ins = [np.all(np.abs((points - c) @ r) <= s / 2, axis=1) for c, r, s in (one, other)]
    counted = np.sum(ins[0] & ins[1]) / np.sum(ins[0] | ins[1])
    assert counted > 0.05
    assert box_overlap(one, other) == pytest.approx(counted, abs=0.01)


def test_names_of_axes_and_motions_of_both_make_no_difference():
    rng = np.random.default_rng(0)
    one, other = some_box(rng), some_box(rng)
    renamed = (other[0], other[1] @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0.0]]), other[2][[1, 2, 0]])
    assert {tuple(corner) for corner in box_corners(other).round(9)} == {
        tuple(c) for c in box_corners(renamed).round(9)
    }
    assert box_overlap(one, renamed) == pytest.approx(box_overlap(one, other))
    turn = Rotation.random(random_state=rng).as_matrix()
    moved = [(turn @ center + [1, 2, 3], turn @ rotation, size) for center, rotation, size in (one, other)]
    assert box_overlap(*moved) == pytest.approx(box_overlap(one, other))
