from dataclasses import replace
from pathlib import Path

import pytest
import torch

from benchmark.studies.claims.scenes import read_scenes
from datagen.errors import UsageError
from obpose.geometry import all_rays
from tests.benchmark.studies.claims.oracle_model import only_scene, true_account
from tests.worlds.traced import write_dataset

pytestmark = pytest.mark.usefixtures("short_clips")


def test_the_slot_with_an_objects_pixels_follows_it(claims_dataset: Path):
    told = true_account(only_scene(claims_dataset))
    seen = [row for row in range(told.scene.truth.count) if (told.segmentation.labels == row + 1).any()]
    assert [(found.row, found.slot) for found in told.found] == [(row, row) for row in seen]


def test_an_object_that_slots_share_or_that_shares_a_slot_is_nobodys(claims_dataset: Path):
    told = true_account(only_scene(claims_dataset))
    labels = told.segmentation.labels.clone()
    first = (labels == 1).nonzero()
    labels[tuple(first[::2].T)] = 3
    assert 0 not in {found.row for found in replace(told, segmentation=replace(told.segmentation, labels=labels)).found}
    everything = replace(told.segmentation, labels=torch.ones_like(labels))
    assert replace(told, segmentation=everything).found == []


def test_scenes_of_several_cameras_are_refused(tmp_path: Path):
    stills = write_dataset(tmp_path / "stills", scenes=1, frames=1, views=2, size=(16, 12))
    with pytest.raises(UsageError, match="stills has 2 views; expected clips that one camera sees"):
        next(read_scenes(stills, "test", 1))


def test_objects_begin_where_their_pixels_are(claims_dataset: Path):
    scene = only_scene(claims_dataset)
    rays = all_rays(scene.observation)
    for row in range(scene.truth.count):
        mine = torch.from_numpy(scene.truth.record["segmentation"][0]).flatten() == row + 1
        for step, inside in ((-0.003, False), (0.001, True)):
            points = (rays.origin + rays.direction * (rays.depth[..., None] + step))[0, 0, mine]
            # Along a grazing ray even a millimetre may leave the object again.
            assert (scene.occupied(row, 0, points) == inside).float().mean() > 0.8


def test_the_middle_of_an_object_lies_between_its_extremes(claims_dataset: Path):
    scene = only_scene(claims_dataset)
    for row, shape in enumerate(scene.truth.shapes):
        pose = scene.truth.world_from_object[1, row]
        reach = (torch.from_numpy(shape.vertices @ pose[:3, :3].T + pose[:3, 3]) - scene.center(row, 1)).numpy()
        assert reach.max(axis=0) == pytest.approx(-reach.min(axis=0), abs=1e-6)
