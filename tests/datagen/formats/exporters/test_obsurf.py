from pathlib import Path

import numpy as np
import pytest
from imageio.v3 import imread

from datagen.errors import UsageError
from datagen.formats.export import export
from datagen.formats.exporters import obsurf
from datagen.geometry import unproject
from tests.datagen.formats.conftest import Export, source


def loader_points(folder: Path, scene: int, view: int) -> np.ndarray:
    """Surface points of an image as ObSuRF's loader computes them: 35 mm lens, 32 mm sensor, aimed at the origin."""
    position = np.load(folder / "metadata.npz")["camera_pos"][scene, view].astype(np.float64)
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    x, y = np.meshgrid((np.arange(320) + 0.5) / 320 * 32 - 16, (np.arange(240) + 0.5) / 240 * 24 - 12)
    rays = x[..., None] * right + y[..., None] * np.cross(forward, right) + 35 * forward
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    distance = imread(folder / "depths" / f"depths_{scene}_{view}.png").astype(np.float32) / (65536 * 0.025)
    return position + distance[..., None] * rays


def test_the_loader_finds_the_scene_s_points_and_masks(clevr: Path, exported: Export):
    folder, scene = exported(clevr, "obsurf"), source(clevr)
    for frame in range(2):
        for view in range(2):
            points = loader_points(folder, frame, view) / obsurf.UNITS_PER_METRE
            expected = unproject(scene.depth[frame, view], scene.k[frame, view], scene.world_from_camera[frame, view])
            there = scene.depth[frame, view] > 0
            assert np.max(np.abs(points - expected)[there]) < 1e-4
            masks = imread(folder / "masks" / f"masks_{frame}_{view}.png")
            np.testing.assert_array_equal(masks, scene.segmentation[frame, view])


def test_rays_without_return_are_farthest(clevr: Path, exported: Export):
    folder, scene = exported(clevr, "obsurf"), source(clevr)
    missing = scene.depth[0, 0] == 0
    assert missing.any()
    assert np.all(imread(folder / "depths" / "depths_0_0.png")[missing] == 65535)


def test_the_loader_skips_numbers_without_images():
    row = {"shape": np.array([3] + 9 * [0], np.int32), "camera_pos": np.ones((2, 3), np.float32)}
    arrays = obsurf.metadata({0: row, obsurf.FIRST["val"]: row})
    assert len(arrays["camera_pos"]) == obsurf.FIRST["val"] + 1
    accepted = np.flatnonzero((arrays["shape"] > 0).sum(axis=1) <= 6)
    assert accepted.tolist() == [0, obsurf.FIRST["val"]]


def test_other_cameras_are_refused_with_the_command_that_helps(clips: Path, clevr: Path, tmp_path: Path):
    with pytest.raises(UsageError, match=r"320x240 pixels, not 64x64; .* --rig.field-of-view 49.13434"):
        export(clips, tmp_path / "out", "obsurf")
    scene = source(clevr)
    scene.k = scene.k * [[349 / 350], [349 / 350], [1]]
    with pytest.raises(UsageError, match="up to 1 pixels away"):
        obsurf.write(tmp_path / "out", [scene])
    assert not (tmp_path / "out").exists()


def test_a_camera_straight_above_the_origin_is_refused(clevr: Path, tmp_path: Path):
    scene = source(clevr)
    scene.world_from_camera = scene.world_from_camera.copy()
    scene.world_from_camera[0, 1, :2, 3] = 0
    with pytest.raises(UsageError, match=r"view 1: .* straight above the origin.*--rig.target 0 0 0"):
        obsurf.write(tmp_path / "out", [scene])


def test_more_scenes_than_the_loader_reads_are_refused(clevr: Path, tmp_path: Path):
    with pytest.raises(UsageError, match="at most 1 train scenes"):
        obsurf.write(tmp_path, [source(clevr)], most={"train": 1})
