import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from benchmark.clips import ClipSequence, TruthSequence
from benchmark.models.interface import Clip
from datagen import config, schema
from datagen.errors import UsageError
from datagen.storage import reader, spec
from tests.worlds.traced import write_dataset


def test_clips_hold_what_cameras_saw_and_no_labels(tmp_path: Path):
    scenes = reader.Dataset(write_dataset(tmp_path / "data", views=2)).split("val")
    clips = ClipSequence(scenes)
    assert len(clips) == len(clips[:]) == 3
    record, clip = scenes[1], clips[1]
    seen = {"rgb", "depth", "valid", "k", "world_from_camera"}
    assert {field.name for field in dataclasses.fields(Clip)} == {*seen, "truth"}
    assert clip.truth is None
    np.testing.assert_array_equal(clip.rgb, record["rgb"])
    np.testing.assert_array_equal(clip.depth, schema.decode_depth(record["depth"]))
    np.testing.assert_array_equal(clip.k, record["camera/K"])
    np.testing.assert_array_equal(clip.world_from_camera, record["camera/world_from_camera"])
    assert clip.valid.all()


def test_clips_carry_the_truth_only_when_asked(tmp_path: Path):
    scenes = reader.Dataset(write_dataset(tmp_path / "data", views=2)).split("val")
    np.testing.assert_array_equal(ClipSequence(scenes, uses_labels=True)[1].truth, scenes[1]["segmentation"])


def test_truths_are_read_apart(tmp_path: Path):
    scenes = reader.Dataset(write_dataset(tmp_path / "data", views=2)).split("val")
    truths = TruthSequence(scenes)
    assert len(truths) == len(truths[:]) == 3
    np.testing.assert_array_equal(truths[1], scenes[1]["segmentation"])


def test_a_sensors_depth_is_what_is_seen(tmp_path: Path):
    scenes = reader.Dataset(write_dataset(tmp_path / "data", sensor=True)).split("val")
    record, clip = scenes[0], ClipSequence(scenes)[0]
    np.testing.assert_array_equal(clip.depth, schema.decode_depth(record["sensor_depth"]))
    np.testing.assert_array_equal(clip.valid, record["sensor_valid"] > 0)


@pytest.mark.usefixtures("unchecked")
def test_scenes_without_images_are_refused(tmp_path: Path):
    recipe = config.recipe_to_dict(config.Recipe())
    facts = spec.make_spec(recipe, seed=0, splits={"train": 1}, resolution=None, renderer=None)
    (tmp_path / spec.SPEC_FILE).write_text(json.dumps(facts))
    with pytest.raises(UsageError, match="holds no images"):
        ClipSequence(reader.Dataset(tmp_path).split("train"))
