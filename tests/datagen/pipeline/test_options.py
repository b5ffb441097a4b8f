"""Signals, cameras and empty scenes from the recipe to a verified dataset."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from benchmark.clips import ClipSequence
from datagen.config import Objects, Rig, load_recipe, recipe_from_dict, recipe_to_dict
from datagen.errors import UsageError
from datagen.pipeline.generate import generate, regenerate, render
from datagen.schema import SIGNALS
from datagen.storage.cameras_file import read_cameras
from datagen.storage.reader import Dataset
from datagen.verify.dataset import find
from obpose.data.datasets import SceneDataset
from tests.worlds.generated import recipe

CAMERAS = {
    "views": [
        {
            "width": 40,
            "height": 32,
            "K": [[36, 0, 18], [0, 38, 17], [0, 0, 1]],
            "world_from_camera": [
                [[0, 0.6, -0.8, 0.9 - 0.02 * frame], [1, 0, 0, 0.05 * frame], [0, -0.8, -0.6, 0.7]]
                for frame in range(3)
            ],
        }
    ]
}
PATHS = "camera/world_from_camera_of_frame"


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip whose camera follows a file, with all signals."""
    folder = tmp_path_factory.mktemp("cameras")
    (folder / "cameras.json").write_text(json.dumps(CAMERAS))
    cameras = read_cameras(folder / "cameras.json")
    generate(folder / "clips", recipe(), splits={"val": 1}, cameras=cameras, signals=SIGNALS)
    return folder / "clips"


def test_clips_with_cameras_of_a_file_are_verified_and_made_anew(clips: Path):
    record = Dataset(clips).split("val")[0]
    assert record["rgb"].shape == (3, 1, 32, 40, 3)
    np.testing.assert_allclose(record[PATHS][2, 0, :3, 3], [0.86, 0.1, 0.7])
    assert find(clips) == []
    assert regenerate(clips, "val", 0) == []


def test_verify_finds_cameras_that_are_not_those_of_the_spec(clips: Path):
    dataset = Dataset(clips)
    assert dataset.signals == SIGNALS
    from datagen.verify.cameras import check_cameras

    views = json.loads(json.dumps(dataset.spec["cameras"]))
    views[0]["poses"][1][0] += 0.001
    assert list(check_cameras(dataset.split("val")[0], recipe(), views))


def test_readers_that_take_one_pose_refuse_moving_cameras(clips: Path):
    with pytest.raises(UsageError, match="takes one pose for all frames"):
        SceneDataset(clips, "val")
    with pytest.raises(UsageError, match="the benchmark takes one pose"):
        ClipSequence(Dataset(clips).split("val"))
    frames = SceneDataset(clips, "val", frames=1, window="all")
    np.testing.assert_allclose(frames[2]["world_from_camera"][0, :3, 3], [0.86, 0.1, 0.7], atol=1e-6)
    assert SceneDataset(clips, "val", extra=[PATHS])[0][PATHS].shape == (3, 1, 4, 4)


def test_scenes_are_rendered_again_with_still_cameras(clips: Path, tmp_path: Path):
    still = dataclasses.replace(recipe(), rig=Rig(distance=1.05))
    render(clips, tmp_path, rig=still, resolution=(32, 32))
    assert PATHS not in Dataset(tmp_path).split("val")[0]
    assert find(tmp_path) == []


def test_scenes_without_images_take_less_than_a_kilobyte_a_frame(tmp_path: Path):
    generate(tmp_path, recipe(frames=10), splits={"train": 20}, renderer=None)
    assert sum(path.stat().st_size for path in tmp_path.glob("*.h5")) < 20 * 10 * 1000


def test_empty_scenes_are_verified(tmp_path: Path):
    empty = recipe(objects=Objects(minimum=0, maximum=0), rig=Rig(motion="orbit"))
    generate(tmp_path, empty, splits={"val": 1}, resolution=(32, 24), signals=SIGNALS)
    record = Dataset(tmp_path).split("val")[0]
    assert record["objects/count"] == 0
    assert not np.any(record["segmentation"])
    assert np.any(record["flow/forward"]), "the camera moves"
    assert find(tmp_path) == []


def test_constants_at_their_defaults_do_not_change_the_identity_of_older_datasets():
    values = recipe_to_dict(load_recipe("moving"))
    assert "motion" not in values["rig"]
    assert "device" not in values["sensor"]
    moving = dataclasses.replace(load_recipe("moving"), rig=Rig(motion="orbit"))
    assert recipe_from_dict(recipe_to_dict(moving)) == moving
