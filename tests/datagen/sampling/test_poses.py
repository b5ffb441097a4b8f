import numpy as np
import pytest

from datagen.catalog import CATEGORIES, sample_shape
from datagen.sampling import poses
from datagen.shapes import build
from datagen.shapes.shape import Shape


def shape(category: str, seed: int = 0) -> Shape:
    return build(sample_shape(category, np.random.default_rng(seed), (0.1, 0.1)))


SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@pytest.mark.parametrize(("point", "depth"), [((0, 0), 1.0), ((0.4, 0), 0.6), ((1.0, 0), 0.0), ((1.5, 0), -0.5)])
def test_depth_inside_is_the_distance_to_the_outline(point: tuple[float, float], depth: float):
    assert poses.depth_inside(SQUARE, np.array(point, float)) == pytest.approx(depth, abs=1e-12)


def test_a_box_has_six_steady_stances_and_a_ball_none():
    assert len(poses.steady_stances(shape("cube"))) == 6
    assert poses.steady_stances(shape("sphere")) == []


def test_a_cone_stands_on_its_base_only():
    (stance,) = poses.steady_stances(shape("cone"))
    assert stance.rotation[2, 2] == pytest.approx(1)


@pytest.mark.parametrize("category", ["mug", "bracket", "gear", "hammer", "bottle"])
def test_stances_are_rotations_and_rest_on_their_base(category: str):
    stances = poses.steady_stances(shape(category))
    assert stances
    for stance in stances:
        np.testing.assert_allclose(stance.rotation @ stance.rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(stance.rotation) == pytest.approx(1)
        assert stance.bottom < 0 < stance.top
        assert stance.turned(0.7).bottom == pytest.approx(stance.bottom)
        assert stance.turned(0.7).is_steady


@pytest.mark.parametrize(
    ("category", "rolls"), [("sphere", True), ("cylinder", True), ("torus", True), ("box", False), ("gear", False)]
)
def test_what_is_round_about_its_axis_rolls(category: str, rolls: bool):
    assert poses.can_roll(shape(category)) == rolls


def test_a_rolling_cylinder_lies_on_its_side_across_x():
    cylinder = shape("cylinder")
    stance = poses.rolling_stance(cylinder)
    np.testing.assert_allclose(np.abs(stance.rotation[:, 2]), [0, 1, 0], atol=1e-12)
    assert -stance.bottom == pytest.approx(cylinder.size[0] / 2, abs=1e-3)


def test_tumbled_orientations_have_no_favourite():
    rng = np.random.default_rng(0)
    ups = np.array([poses.tumbled(shape("box"), rng).rotation[2] for _ in range(600)])
    np.testing.assert_allclose(np.mean(ups, axis=0), 0, atol=0.08)
    np.testing.assert_allclose(np.mean(ups**2, axis=0), 1 / 3, atol=0.05)


@pytest.mark.parametrize("category", [name for name, entry in CATEGORIES.items() if entry.group == "furniture"])
def test_furniture_stands_upright(category: str):
    for seed in range(3):
        assert poses.upright(shape(category, seed)).is_steady
