import numpy as np
import pytest

from datagen.geometry import invert_rigid, look_at, transform
from obpose.rgbd.plane import fit_plane
from obpose.rgbd.table import find_table, table_points

CAMERA = look_at(np.array([0.9, 0.0, 0.7]), np.zeros(3))


def rectangle(center: tuple[float, float, float], sides: tuple[float, float, float], points: int) -> np.ndarray:
    """Points of a box of which one side is zero, world frame."""
    return np.array(center) + np.random.default_rng(points).uniform(-0.5, 0.5, (points, 3)) * sides


TABLE = rectangle((0, 0, 0), (0.8, 1.2, 0), 2000)
BOX = rectangle((0.1, 0, 0.1), (0.2, 0.2, 0.2), 300)


def height_of_table(*surfaces: np.ndarray) -> float | None:
    """Height at which the plane that is found crosses the middle of the table, if it is level."""
    plane = find_table(transform(invert_rigid(CAMERA), np.concatenate(surfaces)))
    assert plane is not None
    normal = CAMERA[:3, :3] @ plane.normal
    return float(plane.offset + normal @ CAMERA[:3, 3]) if normal[2] > 0.999 else None


@pytest.mark.parametrize(
    "others",
    [
        (),
        (rectangle((-2, 0, 0.5), (0, 4, 2), 6000),),
        (rectangle((-6, 0, 0.5), (0, 8, 4), 15_000),),
        (rectangle((-0.6, 0, 0.5), (0, 3, 1), 1500),),
        (rectangle((-1, 0, -0.75), (4, 4, 0), 5000),),
        (rectangle((-2, 0, 0.5), (0, 4, 2), 3000), rectangle((-1, 0, -0.75), (2, 4, 0), 3000)),
    ],
    ids=["nothing", "wall", "far wall", "near wall", "floor", "wall and floor"],
)
def test_the_table_is_found_before_walls_and_over_floors(others: tuple[np.ndarray, ...]):
    assert height_of_table(TABLE, BOX, *others) == pytest.approx(0, abs=2e-3)


@pytest.mark.parametrize("depth", [0.05, 0.15, 0.3])
def test_what_is_right_before_the_lens_is_no_table(depth: float):
    """Such as the gripper of a robot."""
    near = np.random.default_rng(0).uniform([-0.05, 0, depth], [0.05, 0.04, depth + 0.005], (600, 3))
    assert height_of_table(TABLE, BOX, transform(CAMERA, near)) == pytest.approx(0, abs=2e-3)


def test_the_side_of_a_box_is_no_table():
    side = rectangle((0.3, 0, 0.15), (0, 0.4, 0.3), 2500)
    assert height_of_table(TABLE, side) == pytest.approx(0, abs=2e-3)


def test_the_largest_plane_alone_would_be_the_wall():
    """Otherwise the tests above would show nothing."""
    points = np.concatenate([TABLE, BOX, rectangle((-2, 0, 0.5), (0, 4, 2), 6000)])
    plane = fit_plane(points, np.random.default_rng(0))
    assert plane is not None
    assert abs(plane.normal[0]) > 0.999


def test_points_of_the_table_are_those_on_its_plane():
    points = transform(invert_rigid(CAMERA), np.concatenate([TABLE, BOX + np.array([0, 0, 0.02])]))
    plane = find_table(points)
    assert plane is not None
    np.testing.assert_array_equal(table_points(points, plane), points[: len(TABLE)])


def test_no_points_are_no_table():
    assert find_table(np.zeros((0, 3))) is None
    assert find_table(np.ones((100, 3))) is None
