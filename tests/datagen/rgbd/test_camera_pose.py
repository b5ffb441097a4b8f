import json
from pathlib import Path

import numpy as np
import pytest

from datagen.errors import CorruptFile, UsageError
from datagen.geometry import look_at, rigid
from datagen.rgbd.camera_pose import read_pose

POSE = look_at(np.array([0.8, 0.1, 0.7]), np.array([0.1, 0.0, 0.0]))


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
def test_matrices_that_are_not_rigid_are_refused(tmp_path: Path, wrong: np.ndarray):
    np.savetxt(tmp_path / "pose.txt", wrong)
    with pytest.raises(UsageError, match="holds no rigid pose; expected world_from_camera"):
        read_pose(tmp_path / "pose.txt")


def test_an_empty_array_file_is_named(tmp_path: Path):
    (tmp_path / "pose.npy").touch()
    with pytest.raises(CorruptFile, match=r"pose\.npy is damaged or no NPY file"):
        read_pose(tmp_path / "pose.npy")


def test_an_archive_of_arrays_is_refused(tmp_path: Path):
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
def test_other_arrays_are_refused(tmp_path: Path, wrong: np.ndarray):
    np.save(tmp_path / "pose.npy", wrong)
    with pytest.raises(UsageError, match="holds no rigid pose"):
        read_pose(tmp_path / "pose.npy")


def test_an_unreadable_pose_is_named(tmp_path: Path):
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
def test_other_json_values_are_refused(tmp_path: Path, value: object):
    (tmp_path / "pose.json").write_text(json.dumps(value))
    with pytest.raises(UsageError, match="holds no rigid pose"):
        read_pose(tmp_path / "pose.json")


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


def test_rounded_rotations_are_accepted(tmp_path: Path):
    pose = rigid(np.array([0.1, 0.2, 0.3]), np.array([0.9, 0.1, -0.3, 0.2])).round(4)
    np.savetxt(tmp_path / "pose.txt", pose)
    np.testing.assert_allclose(read_pose(tmp_path / "pose.txt"), pose)
