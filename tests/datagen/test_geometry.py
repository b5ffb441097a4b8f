import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from datagen.geometry import (
    intrinsics,
    invert_rigid,
    look_at,
    pixel_rays,
    project,
    quaternion_from_rotation,
    rigid,
    rotation_from_quaternion,
    unproject,
)

POSITION, TARGET = np.array([0.8, -0.3, 0.9]), np.array([0.1, 0.2, 0.0])


def random_rotations(count: int) -> Rotation:
    return Rotation.random(count, rng=np.random.default_rng(0))


def test_the_target_projects_to_the_middle_of_the_image_at_its_distance():
    k = intrinsics(np.radians(40), 128, 96)
    pixel, depth = project(TARGET, k, look_at(POSITION, TARGET))
    np.testing.assert_allclose(pixel, [64, 48], atol=1e-9)
    np.testing.assert_allclose(depth, np.linalg.norm(TARGET - POSITION))


def test_what_is_above_the_target_appears_above_and_what_is_to_the_right_appears_right():
    k, camera = intrinsics(np.radians(40), 128, 128), look_at(np.array([1.0, 0, 1]), np.zeros(3))
    above, _ = project(np.array([0, 0, 0.1]), k, camera)
    right, _ = project(np.array([0, 0.1, 0]), k, camera)
    assert above[1] < 64
    assert above[0] == pytest.approx(64)
    assert right[0] > 64
    assert right[1] == pytest.approx(64)


@pytest.mark.parametrize("target", [POSITION, POSITION - np.array([0, 0, 1.0])])
def test_a_camera_without_a_defined_roll_is_refused(target):
    with pytest.raises(ValueError, match="move"):
        look_at(POSITION, target)


def test_the_field_of_view_spans_the_width():
    k = intrinsics(np.radians(40), 128, 128)
    assert k[0, 0] == pytest.approx(175.83856, abs=1e-4)  # the paper's camera
    edge = pixel_rays(k, 128, 128)[64, 0]
    assert np.degrees(np.arctan(-(edge[0] - 0.5 / k[0, 0]))) == pytest.approx(20, abs=0.5)


def test_unprojecting_undoes_projecting():
    rng = np.random.default_rng(0)
    k, camera = intrinsics(np.radians(50), 40, 30), look_at(POSITION, TARGET)
    depth = rng.uniform(0.5, 2, (30, 40))
    pixels, z = project(unproject(depth, k, camera), k, camera)
    columns, rows = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=-1), atol=1e-9)
    np.testing.assert_allclose(z, depth)


def test_quaternions_and_rotations_agree_with_scipy_and_with_each_other():
    for rotation in random_rotations(200):
        matrix = rotation.as_matrix()
        quaternion = quaternion_from_rotation(matrix)
        assert quaternion[0] >= 0
        np.testing.assert_allclose(quaternion, rotation.as_quat(canonical=True, scalar_first=True), atol=1e-12)
        np.testing.assert_allclose(rotation_from_quaternion(quaternion), matrix, atol=1e-12)


def test_half_turns_survive_the_way_to_quaternions_and_back():
    for axis in np.eye(3):
        matrix = Rotation.from_rotvec(np.pi * axis).as_matrix()
        np.testing.assert_allclose(rotation_from_quaternion(quaternion_from_rotation(matrix)), matrix, atol=1e-9)


def test_inverting_a_pose_undoes_it():
    quaternions = random_rotations(5).as_quat(scalar_first=True)
    poses = rigid(np.random.default_rng(1).normal(size=(5, 3)), quaternions)
    np.testing.assert_allclose(invert_rigid(poses) @ poses, np.broadcast_to(np.eye(4), (5, 4, 4)), atol=1e-12)
