import json
from pathlib import Path

import numpy as np
from imageio.v3 import imread

from datagen.formats.exporters.rgbd import write
from tests.datagen.formats.conftest import Export, source


def test_images_and_cameras_of_every_view_are_the_dataset_s(stills: Path, exported: Export):
    folder, scene = exported(stills, "rgbd") / "train" / "000000", source(stills)
    for view in range(2):
        place = folder / f"view{view}"
        np.testing.assert_array_equal(imread(place / "rgb" / "000000.png"), scene.rgb[0, view])
        np.testing.assert_array_equal(imread(place / "masks" / "000000.png"), scene.segmentation[0, view])
        np.testing.assert_array_equal(imread(place / "depth" / "000000.png"), scene.read("depth")[0, view])
        camera = json.loads((place / "camera.json").read_text())
        k = [[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]
        np.testing.assert_array_equal(k, scene.k[0, view])
        np.testing.assert_array_equal(np.loadtxt(place / "world_from_camera.txt"), scene.world_from_camera[0, view])
    assert [each["category"] for each in json.loads((place / "objects.json").read_text())] == scene.categories


def test_clips_have_one_image_per_frame(clips: Path, exported: Export):
    folder = exported(clips, "rgbd") / "train" / "000001"
    assert sorted(path.name for path in (folder / "rgb").iterdir()) == [f"{frame:06d}.png" for frame in range(3)]


def test_moving_cameras_have_a_pose_per_frame(clips: Path, tmp_path: Path):
    scene, poses = source(clips), np.tile(np.eye(4), (3, 1, 1, 1))
    poses[:, 0, 0, 3] = [0.1, 0.2, 0.3]
    scene.world_from_camera = poses
    write(tmp_path, [scene])
    folder = tmp_path / "train" / "000000"
    assert not (folder / "world_from_camera.txt").exists()
    assert [np.loadtxt(folder / "poses" / f"{frame:06d}.txt")[0, 3] for frame in range(3)] == [0.1, 0.2, 0.3]
