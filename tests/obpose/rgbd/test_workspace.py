import numpy as np
import pytest

from obpose.errors import UsageError
from obpose.rgbd.workspace import CELL, LEAST_FLOOR, MOST_FLOOR, RIM, Workspace, find_workspace, rectangle


def table(width: float = 0.8, depth: float = 0.6, noise: float = 0.0, at: tuple[float, float, float] = (0, 0, 0)):
    """Points on a table, one in each square centimetre."""
    x, y = np.meshgrid(np.arange(-width / 2, width / 2, 0.01), np.arange(-depth / 2, depth / 2, 0.01))
    z = noise * np.random.default_rng(0).standard_normal(x.size)
    return np.column_stack([x.ravel(), y.ravel(), z]) + np.array(at)


def bounds(workspace: Workspace) -> np.ndarray:
    return np.concatenate([workspace.outline.min(axis=0), workspace.outline.max(axis=0)])


def test_the_outline_is_that_of_the_table():
    np.testing.assert_allclose(bounds(find_workspace(table())), [-0.4, -0.3, 0.4, 0.3], atol=CELL)


def test_what_objects_hide_belongs_to_the_table():
    points = table()
    hidden = (np.abs(points[:, 0]) < 0.04) | (np.hypot(*points[:, :2].T) < 0.15)
    np.testing.assert_allclose(bounds(find_workspace(points[~hidden])), [-0.4, -0.3, 0.4, 0.3], atol=CELL)


@pytest.mark.parametrize("at", [(1.5, 0.0, 0.0), (0.0, 0.0, -0.7)], ids=["another table", "floor"])
def test_other_level_surfaces_do_not_belong_to_it(at: tuple[float, float, float]):
    both = np.concatenate([table(), table(0.5, 0.5, at=at)])
    np.testing.assert_allclose(bounds(find_workspace(both)), [-0.4, -0.3, 0.4, 0.3], atol=CELL)


def test_it_holds_what_is_above_the_table():
    space = find_workspace(table())
    inside = np.array([(0, 0, 0), (0, 0, 0.3), (0.39, 0.29, 0.1), (0.4 + RIM / 2, 0, 0.1)])
    outside = np.array([(0, 0, -0.1), (0, 0, 1), (0.5, 0, 0.1), (0, -0.4, 0.1)])
    assert space.holds(inside).all()
    assert not space.holds(outside).any()
    np.testing.assert_array_equal(space.standing(inside, np.ones(4)), [False, True, True, True])


@pytest.mark.parametrize(("noise", "floor"), [(0.0, LEAST_FLOOR), (0.002, 0.008), (0.1, MOST_FLOOR)])
def test_objects_begin_above_the_noise(noise: float, floor: float):
    assert find_workspace(table(noise=noise)).floor == pytest.approx(floor, rel=0.1)


def test_a_rectangle_is_given_by_its_bounds():
    space = rectangle((-0.1, 0.3, -0.2, 0.2), 0.004)
    np.testing.assert_array_equal(space.holds(np.array([(0.0, 0.0, 0.1), (-0.101, 0.0, 0.1)])), [True, False])


def test_objects_begin_higher_where_depth_is_noisier():
    space = find_workspace(table(noise=0.002))
    points = np.array([(x, 0, z) for x in np.arange(-0.3, 0.3, 0.01) for z in (0.0, 0.015)])
    depth = np.where(points[:, 0] > 0.2, 1.5, 1.0)  # 8 mm at 1 m are 12 mm if linear in depth, 18 mm if quadratic
    np.testing.assert_array_equal(space.standing(points, depth), (points[:, 2] > 0) & (depth < 1.5))


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.full((9, 3), 0.5), np.zeros((2, 3))])
def test_without_a_table_there_is_no_workspace(points: np.ndarray):
    with pytest.raises(UsageError, match="No table is visible at z = 0"):
        find_workspace(points)
