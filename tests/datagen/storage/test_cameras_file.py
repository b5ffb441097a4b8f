import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.errors import CorruptFile, UsageError
from datagen.geometry import look_at
from datagen.storage.cameras_file import CamerasFile, cameras_from_values, read_cameras

POSE = look_at(np.array([0.8, 0.1, 0.9]), np.zeros(3))
VIEW: dict[str, Any] = {"width": 160, "height": 120, "fx": 150, "fy": 140, "cx": 70, "cy": 65}


def write(folder: Path, *views: dict[str, Any], **more: Any) -> Path:
    path = folder / "cameras.json"
    path.write_text(json.dumps({"views": views, **more}))
    return path


def read(folder: Path, *views: dict[str, Any], **more: Any) -> CamerasFile:
    return read_cameras(write(folder, *views, **more))


def test_a_camera_has_the_matrix_and_pose_of_the_file(tmp_path: Path):
    file = read(tmp_path, {**VIEW, "world_from_camera": POSE.tolist()})
    (camera,) = cameras_from_values(file.views)
    assert (file.resolution, file.frames, camera.moves) == ((160, 120), 1, False)
    np.testing.assert_allclose(camera.world_from_camera, POSE, atol=1e-8)
    np.testing.assert_allclose(camera.k(160, 120), [[150, 0, 70], [0, 140, 65], [0, 0, 1]])
    np.testing.assert_allclose(camera.k(80, 60), [[75, 0, 35], [0, 70, 32.5], [0, 0, 1]])


def test_a_camera_may_have_a_pose_for_each_frame(tmp_path: Path):
    later = look_at(np.array([0.8, 0.3, 0.9]), np.zeros(3))
    file = read(tmp_path, {**VIEW, "world_from_camera": [POSE.tolist(), later.tolist()]})
    (camera,) = cameras_from_values(file.views)
    assert camera.moves
    np.testing.assert_allclose(camera.at(1).world_from_camera, later, atol=1e-8)
    file.check_frames(2)
    with pytest.raises(UsageError, match=r"has 2 poses for a view, but clips have 10 frames\. Give --frames 2"):
        file.check_frames(10)


def test_other_conventions_mean_the_same_camera(tmp_path: Path):
    matrix = [[150, 0, 70], [0, 140, 65], [0, 0, 1]]
    size = {"width": 160, "height": 120, "K": matrix}
    opengl = (POSE @ np.diag([1, -1, -1, 1])).tolist()
    wanted = read(tmp_path, {**VIEW, "world_from_camera": POSE.tolist()}).views
    for view, more in (
        ({**size, "world_from_camera": opengl}, {"convention": "opengl"}),
        ({**size, "camera_from_world": np.linalg.inv(POSE).tolist()}, {}),
        ({**VIEW, "world_from_camera": POSE[:3].tolist()}, {}),
    ):
        found = read(tmp_path, view, **more).views
        np.testing.assert_allclose(found[0].pop("poses"), wanted[0]["poses"], atol=1e-8)
        assert found[0] == {name: value for name, value in wanted[0].items() if name != "poses"}


def changed(row: int, column: int, value: float) -> list[list[float]]:
    pose = POSE.copy()
    pose[row, column] = value
    return pose.tolist()


GOOD = {**VIEW, "world_from_camera": POSE.tolist()}


@pytest.mark.parametrize(
    ("view", "words"),
    [
        ({"world_from_camera": changed(0, 0, 0.7)}, "holds no rotation: its columns are off"),
        ({"world_from_camera": (POSE @ np.diag([-1, 1, 1, 1])).tolist()}, "mirrors: its determinant is -1"),
        ({"world_from_camera": (POSE @ np.diag([1000, 1000, 1000, 1])).tolist()}, "Remove scale and shear"),
        ({"world_from_camera": changed(0, 3, 800.0)}, "Convert millimetres to metres"),
        ({"world_from_camera": POSE.T.tolist()}, "expected 0 0 0 1"),
        ({"world_from_camera": changed(0, 3, float("nan"))}, "NaN|not 4 x 4"),
        ({"world_from_camera": [[1, 2], [3, 4]]}, "is not 4 x 4 numbers"),
        ({"world_from_camera": "origin"}, "is not 4 x 4 numbers"),
        ({"fx": -150}, "fx is -150; expected a focal length"),
        ({"fx": 10**400}, "fx is not a number"),
        ({"width": 4}, "width is 4; expected a whole number of pixels from 8 to 4096"),
        ({"K": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, "needs either K or all of fx"),
        ({"distortion": [0.1]}, "unknown key 'distortion'"),
        ({"camera_from_world": POSE.tolist()}, "needs either world_from_camera or camera_from_world"),
    ],
)
def test_an_impossible_view_is_named(tmp_path: Path, view: dict[str, Any], words: str):
    with pytest.raises((UsageError, CorruptFile), match=words) as error:
        read(tmp_path, GOOD, {**GOOD, **view})
    assert "cameras.json" in str(error.value)


def test_views_have_one_size_and_as_many_poses(tmp_path: Path):
    with pytest.raises(UsageError, match=r"different sizes \(160x120, 320x120\)"):
        read(tmp_path, GOOD, {**GOOD, "width": 320})
    two, three = ({**GOOD, "world_from_camera": [POSE.tolist()] * count} for count in (2, 3))
    with pytest.raises(UsageError, match="2, 3 poses"):
        read(tmp_path, GOOD, two, three)


def test_a_file_that_is_missing_or_no_json_is_refused(tmp_path: Path):
    with pytest.raises(UsageError, match="there is no such file"):
        read_cameras(tmp_path / "none.json")
    (tmp_path / "half.json").write_text('{"views": [')
    with pytest.raises(CorruptFile, match=r"half\.json"):
        read_cameras(tmp_path / "half.json")
    with pytest.raises(UsageError, match="holds no list of cameras"):
        read(tmp_path)
