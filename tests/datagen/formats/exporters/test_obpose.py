import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.errors import UsageError
from datagen.formats.exporters.obpose import write
from tests.datagen.formats.conftest import Export, source


def load(path: Path) -> Any:
    with path.open("rb") as file:
        np.lib.format.read_magic(file)
        np.lib.format.read_array_header_1_0(file)
        return pickle.load(file)


def authors_points(depth: np.ndarray, camera: dict[str, np.ndarray]) -> np.ndarray:
    """World points with the authors' formula: integer pixels, and the inverse of K and of the pose."""
    height, width = depth.shape
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    local = np.stack([u * depth, v * depth, depth], axis=-1) @ np.linalg.inv(camera["camera_intrinsics"]).T
    return local @ camera["camera_extrinsics"][:3, :3].T + camera["camera_extrinsics"][:3, 3]


def test_clips_are_lists_of_frames(clips: Path, exported: Export):
    folder, scene = exported(clips, "obpose"), source(clips, 1)
    frames = load(folder / "train" / "1.npy")
    assert len(frames) == 3
    camera = load(folder / "camera_info.npy").item()
    assert camera["camera_intrinsics"][0, 0] < 0
    for frame, values in enumerate(frames):
        np.testing.assert_array_equal(np.rint(255 * values["rgb"]), scene.rgb[frame, 0])
        np.testing.assert_array_equal(values["mask_bin"].argmax(axis=-1), scene.segmentation[frame, 0])
        assert np.all(values["mask_bin"].sum(axis=-1) == 1)
        assert values["mask_bin"].shape[-1] == 3
        assert [each["name"] for each in values["obj_list"]] == ["box", "cylinder"]
        there = values["depth"] > 0
        away = authors_points(values["depth"], camera) - values["pcd"]
        assert np.max(np.abs(away[there])) < 1e-5


def test_stills_are_one_file_per_view(stills: Path, exported: Export):
    folder, scene = exported(stills, "obpose"), source(stills)
    assert sorted(path.name for path in folder.rglob("*.npy")) == ["0.npy", "1.npy"]
    for view in range(2):
        values = load(folder / "train" / f"{view}.npy").item()
        assert values["mask_bin"].shape == (48, 64, 5)
        away = authors_points(values["depth"], values["misc"]) - values["pcd"]
        assert np.max(np.abs(away[values["depth"] > 0])) < 1e-5
        np.testing.assert_array_equal(values["depth"], scene.depth[0, view])


def test_clips_with_different_cameras_are_refused(clips: Path, tmp_path: Path):
    scenes = [source(clips, index) for index in range(2)]
    scenes[1].world_from_camera = scenes[1].world_from_camera @ np.diag([-1, -1, 1, 1])
    with pytest.raises(UsageError, match=r"train scene 1: its cameras differ .* --rig.jitter 0"):
        write(tmp_path, scenes)
