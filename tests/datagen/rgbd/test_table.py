import numpy as np
import pytest

from datagen.errors import NoTable
from datagen.geometry import invert_rigid, look_at, transform
from datagen.rgbd.plane import fit_plane
from datagen.rgbd.table import find_table, pose_over_table, table_points

CAMERA = look_at(np.array([0.9, 0.0, 0.7]), np.zeros(3))
POSE = look_at(np.array([0.8, 0.1, 0.7]), np.array([0.1, 0.0, 0.0]))


def rectangle(center: tuple[float, float, float], sides: tuple[float, float, float], points: int) -> np.ndarray:
    """Random points of a rectangle (a box with one side of length 0), world frame."""
    return np.array(center) + np.random.default_rng(points).uniform(-0.5, 0.5, (points, 3)) * sides


TABLE = rectangle((0, 0, 0), (0.8, 1.2, 0), 2000)
BOX = rectangle((0.1, 0, 0.1), (0.2, 0.2, 0.2), 300)


def height_of_table(*surfaces: np.ndarray) -> float | None:
    """Height of the found table at the origin; None if it is not level."""
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
def test_the_table_wins_over_walls_and_floors(others: tuple[np.ndarray, ...]):
    assert height_of_table(TABLE, BOX, *others) == pytest.approx(0, abs=2e-3)


@pytest.mark.parametrize("depth", [0.05, 0.15, 0.3])
def test_an_object_before_the_lens_is_not_the_table(depth: float):
    near = np.random.default_rng(0).uniform([-0.05, 0, depth], [0.05, 0.04, depth + 0.005], (600, 3))
    assert height_of_table(TABLE, BOX, transform(CAMERA, near)) == pytest.approx(0, abs=2e-3)


def test_the_side_of_a_box_is_not_the_table():
    side = rectangle((0.3, 0, 0.15), (0, 0.4, 0.3), 2500)
    assert height_of_table(TABLE, side) == pytest.approx(0, abs=2e-3)


def test_the_largest_plane_is_the_wall():
    """Guard: otherwise the tests above would prove nothing."""
    points = np.concatenate([TABLE, BOX, rectangle((-2, 0, 0.5), (0, 4, 2), 6000)])
    plane = fit_plane(points, np.random.default_rng(0))
    assert plane is not None
    assert abs(plane.normal[0]) > 0.999


def test_table_points_exclude_the_box():
    points = transform(invert_rigid(CAMERA), np.concatenate([TABLE, BOX + np.array([0, 0, 0.02])]))
    plane = find_table(points)
    assert plane is not None
    np.testing.assert_array_equal(table_points(points, plane), points[: len(TABLE)])


def test_points_without_a_plane_give_no_table():
    assert find_table(np.zeros((0, 3))) is None
    assert find_table(np.ones((100, 3))) is None


def table_with_heap() -> np.ndarray:
    """A table at z = 0 with a heap on it, in a world whose x axis points towards the camera."""
    rng = np.random.default_rng(0)
    flat = np.column_stack([rng.uniform(-0.4, 0.4, (3000, 2)), np.zeros(3000)])
    return np.concatenate([flat, rng.uniform([-0.1, -0.1, 0], [0.1, 0.1, 0.1], (400, 3))])


def seen_from(points: np.ndarray, pose: np.ndarray = POSE) -> np.ndarray:
    return transform(invert_rigid(pose), points)


@pytest.mark.parametrize("position", [(0.8, 0.1, 0.7), (0.3, -0.2, 0.9), (1.0, 0.0, 0.2), (0.01, 0.0, 1.0)])
def test_the_table_is_at_z_0_and_z_points_up(position: tuple[float, float, float]):
    points = seen_from(table_with_heap(), look_at(np.array(position), np.zeros(3)))
    found = transform(pose_over_table(points, center=(0.0, 0.0, 0.0)), points)
    assert np.abs(found[:3000, 2]).max() < 1e-3
    assert np.quantile(found[3000:, 2], 0.99) == pytest.approx(0.1, abs=0.01)


def test_the_pose_is_rigid_and_x_points_to_the_camera():
    pose = pose_over_table(seen_from(table_with_heap()), center=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    assert pose[0, 3] > 0.5
    assert abs(pose[1, 3]) < 0.1
    assert pose[2, 3] == pytest.approx(POSE[2, 3], abs=2e-3)


def test_the_median_of_the_table_is_at_the_given_center():
    points = seen_from(table_with_heap())
    for center in ((0.0, 0.0, 0.0), (0.28, -0.1, 0.07)):
        found = transform(pose_over_table(points, center=center), points)
        on_table = np.abs(found[:, 2]) < 0.009
        np.testing.assert_allclose(np.median(found[on_table], axis=0)[:2], center[:2], atol=2e-3)


@pytest.mark.parametrize("far", [3.0, 6.0, 49.0])
def test_a_far_wall_does_not_move_the_origin(far: float):
    near = seen_from(table_with_heap())
    wall = np.column_stack([*np.random.default_rng(1).uniform(-far / 2, far / 2, (2, 9000)), np.full(9000, far)])
    alone, both = (pose_over_table(points) for points in (near, np.concatenate([near, wall])))
    np.testing.assert_allclose(both, alone, atol=0.01)


def test_from_straight_above_x_points_to_the_lower_side_of_the_image():
    above = np.diag([1.0, -1.0, -1.0, 1.0])
    above[2, 3] = 1.0
    pose = pose_over_table(seen_from(table_with_heap(), above), center=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(pose[:3, :3] @ [0, 1, 0], [1, 0, 0], atol=0.02)


def test_a_missing_plane_is_an_error():
    with pytest.raises(NoTable, match="expected a table in view"):
        pose_over_table(np.zeros((5, 3)), center=(0.0, 0.0, 0.0))
