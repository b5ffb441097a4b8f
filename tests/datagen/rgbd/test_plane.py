import numpy as np
import pytest

from datagen.geometry import rotation_from_quaternion
from datagen.rgbd.plane import FEWEST_POINTS, fit_plane


def table(rng: np.random.Generator, points: int = 4000, noise: float = 0.0) -> np.ndarray:
    """Points of the plane z = 0."""
    xy = rng.uniform(-0.5, 0.5, (points, 2))
    return np.column_stack([xy, rng.normal(0, noise, points) if noise else np.zeros(points)])


def clutter(rng: np.random.Generator, points: int) -> np.ndarray:
    return rng.uniform([-0.5, -0.5, 0.0], [0.5, 0.5, 0.2], (points, 3))


@pytest.mark.parametrize("seed", range(5))
def test_finds_a_plane_under_as_much_clutter(seed: int):
    rng = np.random.default_rng(seed)
    plane = fit_plane(np.concatenate([table(rng), clutter(rng, 4000)]), rng)
    assert plane is not None
    assert abs(plane.normal[2]) > 0.9999
    assert abs(plane.offset) < 2e-4


@pytest.mark.parametrize("quaternion", [(1.0, 0.0, 0.0, 0.0), (0.5, 0.5, -0.5, 0.5), (0.1, -0.7, 0.3, 0.6)])
def test_turning_and_shifting_the_world_turns_and_shifts_the_plane(quaternion: tuple[float, ...]):
    rng = np.random.default_rng(0)
    points = np.concatenate([table(rng, noise=0.001), clutter(rng, 1000)])
    rotation, shift = rotation_from_quaternion(np.array(quaternion)), np.array([0.4, -1.0, 2.0])
    plane = fit_plane(points, np.random.default_rng(1))
    moved = fit_plane(points @ rotation.T + shift, np.random.default_rng(1))
    assert plane is not None
    assert moved is not None
    heights = [
        p.oriented_towards(v).height(x)
        for p, v, x in (
            (plane, np.array([[0.0, 0, 1]]), points),
            (moved, np.array([[0.0, 0, 1]]) @ rotation.T + shift, points @ rotation.T + shift),
        )
    ]
    np.testing.assert_allclose(heights[0], heights[1], atol=1e-9)


def test_spread_is_the_noise():
    rng = np.random.default_rng(0)
    plane = fit_plane(table(rng, 20_000, noise=0.002), rng)
    assert plane is not None
    assert plane.spread == pytest.approx(0.002, rel=0.1)


def test_equal_generators_find_equal_planes():
    points = clutter(np.random.default_rng(0), 500)
    planes = [fit_plane(points, np.random.default_rng(7)) for _ in range(2)]
    assert planes[0] is not None
    assert planes[1] is not None
    assert np.array_equal(planes[0].normal, planes[1].normal)
    assert planes[0].offset == planes[1].offset


def test_the_normal_points_to_the_viewpoints():
    rng = np.random.default_rng(0)
    plane = fit_plane(table(rng), rng)
    assert plane is not None
    above = np.array([[0.3, 0.0, 1.0], [-0.2, 0.1, 0.8]])
    assert np.all(plane.oriented_towards(above).height(above) > 0)
    assert np.all(plane.oriented_towards(-above).height(-above) > 0)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.random.default_rng(0).random((FEWEST_POINTS - 1, 3)),
        np.ones((100, 3)),
        np.linspace(0, 1, 100)[:, None] * np.array([1.0, 0, 0]),
    ],
    ids=["empty", "few", "one point", "one line"],
)
def test_no_plane_where_points_define_none(points: np.ndarray):
    assert fit_plane(points, np.random.default_rng(0)) is None
