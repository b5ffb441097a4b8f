import json
import os
from pathlib import Path

import numpy as np
import pytest

from datagen.geometry import invert_rigid, look_at, rigid, transform
from obpose.errors import CorruptFile, UsageError
from obpose.rgbd.world import pose_over_plane, read_pose

POSE = look_at(np.array([0.8, 0.1, 0.7]), np.array([0.1, 0.0, 0.0]))


def table(seed: int = 0) -> np.ndarray:
    """A table at z = 0 with a heap on it, in a world whose x axis points towards the camera."""
    rng = np.random.default_rng(seed)
    flat = np.column_stack([rng.uniform(-0.4, 0.4, (3000, 2)), np.zeros(3000)])
    return np.concatenate([flat, rng.uniform([-0.1, -0.1, 0], [0.1, 0.1, 0.1], (400, 3))])


def seen(points: np.ndarray, pose: np.ndarray = POSE) -> np.ndarray:
    return transform(invert_rigid(pose), points)


@pytest.mark.parametrize("position", [(0.8, 0.1, 0.7), (0.3, -0.2, 0.9), (1.0, 0.0, 0.2), (0.01, 0.0, 1.0)])
def test_the_plane_is_the_ground_and_up_is_towards_the_camera(position: tuple[float, float, float]):
    points = seen(table(), look_at(np.array(position), np.zeros(3)))
    found = transform(pose_over_plane(points, center=(0.0, 0.0, 0.0)), points)
    assert np.abs(found[:3000, 2]).max() < 1e-3
    assert np.quantile(found[3000:, 2], 0.99) == pytest.approx(0.1, abs=0.01)


def test_the_pose_is_rigid_and_x_points_to_the_camera():
    pose = pose_over_plane(seen(table()), center=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    assert pose[0, 3] > 0.5
    assert abs(pose[1, 3]) < 0.1
    assert pose[2, 3] == pytest.approx(POSE[2, 3], abs=2e-3)


def test_the_median_of_the_table_lies_where_the_model_expects_it():
    points = seen(table())
    for center in ((0.0, 0.0, 0.0), (0.28, -0.1, 0.07)):
        found = transform(pose_over_plane(points, center=center), points)
        on_table = np.abs(found[:, 2]) < 0.009
        np.testing.assert_allclose(np.median(found[on_table], axis=0)[:2], center[:2], atol=2e-3)


@pytest.mark.parametrize("far", [3.0, 6.0, 49.0])
def test_what_is_far_away_does_not_move_the_origin(far: float):
    near = seen(table())
    wall = np.column_stack([*np.random.default_rng(1).uniform(-far / 2, far / 2, (2, 9000)), np.full(9000, far)])
    alone, both = (pose_over_plane(points) for points in (near, np.concatenate([near, wall])))
    np.testing.assert_allclose(both, alone, atol=0.01)


def test_from_straight_above_the_lower_side_is_near():
    """Where the line of sight is vertical no direction points to the camera."""
    above = np.diag([1.0, -1.0, -1.0, 1.0])
    above[2, 3] = 1.0
    pose = pose_over_plane(seen(table(), above), center=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(pose[:3, :3] @ [0, 1, 0], [1, 0, 0], atol=0.02)


def test_no_plane_is_said():
    with pytest.raises(UsageError, match="give --camera-pose"):
        pose_over_plane(np.zeros((5, 3)), center=(0.0, 0.0, 0.0))


@pytest.mark.parametrize("ending", [".txt", ".json", ".npy"])
def test_poses_are_read(tmp_path: Path, ending: str):
    path = tmp_path / f"pose{ending}"
    if ending == ".npy":
        np.save(path, POSE)
    elif ending == ".json":
        path.write_text(json.dumps(POSE.tolist()))
    else:
        np.savetxt(path, POSE)
    np.testing.assert_allclose(read_pose(path), POSE)


def flipped() -> np.ndarray:
    return POSE @ np.diag([-1.0, 1, 1, 1])


@pytest.mark.parametrize(
    "wrong", [POSE[:3], 2 * POSE, flipped(), POSE.T, np.full((4, 4), np.nan), np.full((4, 4), 1e300)]
)
def test_what_is_no_pose_is_refused(tmp_path: Path, wrong: np.ndarray):
    np.savetxt(tmp_path / "pose.txt", wrong)
    with pytest.raises(UsageError, match="holds no rigid pose; expected world_from_camera"):
        read_pose(tmp_path / "pose.txt")


def test_an_empty_array_is_named(tmp_path: Path):
    (tmp_path / "pose.npy").touch()
    with pytest.raises(CorruptFile, match=r"pose\.npy is damaged or no NPY file"):
        read_pose(tmp_path / "pose.npy")


def test_several_arrays_are_no_pose(tmp_path: Path):
    np.savez(tmp_path / "pose.npz", POSE)
    (tmp_path / "pose.npz").rename(tmp_path / "pose.npy")
    with pytest.raises(CorruptFile, match=r"pose\.npy is damaged or no NPY file"):
        read_pose(tmp_path / "pose.npy")


@pytest.mark.parametrize(
    "wrong",
    [
        POSE.astype(complex),
        np.full((4, 4), "1"),
        np.zeros((4, 4), [("x", float)]),
        np.ones((4, 4), bool),
        np.float64(1),
        POSE[None],
        np.full((4, 4), np.longdouble(2) ** 2000),
    ],
    ids=["complex", "text", "structured", "boolean", "single", "stacked", "huge"],
)
def test_other_arrays_are_no_pose(tmp_path: Path, wrong: np.ndarray):
    np.save(tmp_path / "pose.npy", wrong)
    with pytest.raises(UsageError, match="holds no rigid pose"):
        read_pose(tmp_path / "pose.npy")


def test_a_pose_that_cannot_be_read_is_named(tmp_path: Path):
    for name in ("pose.txt", "pose.json"):
        (tmp_path / name).write_text("up and away")
        with pytest.raises(CorruptFile, match=f"{name} cannot be read"):
            read_pose(tmp_path / name)
    with pytest.raises(UsageError, match="does not exist"):
        read_pose(tmp_path / "nowhere.txt")


IDENTITY = np.eye(4).tolist()


@pytest.mark.parametrize(
    "value",
    [
        {"world_from_camera": IDENTITY},
        [IDENTITY],
        [*IDENTITY[:3], [0, 0, 1]],
        [*IDENTITY[:3], [0, 0, 0, "1"]],
        [*IDENTITY[:3], [0, 0, 0, True]],
        [*IDENTITY[:3], [0, 0, 0, None]],
        [*IDENTITY[:3], [0, 0, 0, 10**400]],
        [],
        1,
    ],
    ids=["named", "nested", "ragged", "text", "boolean", "null", "huge", "empty", "single"],
)
def test_other_values_in_json_are_no_pose(tmp_path: Path, value: object):
    (tmp_path / "pose.json").write_text(json.dumps(value))
    with pytest.raises(UsageError, match="holds no rigid pose"):
        read_pose(tmp_path / "pose.json")


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("pose.json", "[" * 5000, "nested more than"),
        ("pose.json", "[[NaN]]", "holds NaN"),
        ("pose.json", "9" * 5000, "cannot be read"),
        ("pose.txt", "1 " * 2**15, "at most 65,536"),
        ("pose.txt", "1 0 0 \udcff", "not UTF-8"),
    ],
    ids=["deep", "nan", "digits", "long", "bytes"],
)
def test_hostile_files_end_in_one_line(tmp_path: Path, name: str, content: str, said: str):
    (tmp_path / name).write_bytes(content.encode("utf-8", "surrogateescape") + b" ")
    with pytest.raises(CorruptFile, match=said) as caught:
        read_pose(tmp_path / name)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("name", ["pose.txt", "pose.json", "pose.npy"])
def test_a_pipe_does_not_hang(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    with pytest.raises(UsageError, match="is a pipe"):
        read_pose(tmp_path / name)


@pytest.mark.parametrize("away", [1001.0, -1e30])
def test_a_camera_that_is_too_far_away_is_refused(tmp_path: Path, away: float):
    pose = POSE.copy()
    pose[1, 3] = away
    np.savetxt(tmp_path / "pose.txt", pose)
    with pytest.raises(UsageError, match="expected metres, at most 1,000"):
        read_pose(tmp_path / "pose.txt")


def test_an_empty_file_holds_no_pose(tmp_path: Path):
    (tmp_path / "pose.txt").write_text("# nothing yet\n")
    with pytest.raises(UsageError, match="holds no rigid pose"):
        read_pose(tmp_path / "pose.txt")


def test_rounded_rotations_pass(tmp_path: Path):
    pose = rigid(np.array([0.1, 0.2, 0.3]), np.array([0.9, 0.1, -0.3, 0.2])).round(4)
    np.savetxt(tmp_path / "pose.txt", pose)
    np.testing.assert_allclose(read_pose(tmp_path / "pose.txt"), pose)
