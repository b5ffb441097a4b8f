from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.studies.inputs import infer_clips, matched_slots
from datagen.errors import UsageError
from obpose.geometry import all_rays
from tests.benchmark.studies.oracle_model import relabelled, true_clip, untrained
from tests.worlds.traced import write_dataset


def test_a_slot_matches_an_object_if_most_of_their_union_is_shared():
    truth = np.array([[[1, 1, 1, 1, 2, 2, 2, 2, 0, 0]]])
    for labels, slots in (
        ([3, 3, 3, 3, 1, 1, 1, 1, 0, 0], [2, 0]),
        ([0, 0, 0, 0, 0, 0, 0, 0, 0, 0], [-1, -1]),  # the background matches nothing
        ([1, 1, 2, 2, 1, 1, 1, 1, 1, 1], [-1, -1]),  # exactly half of the union, or less
        ([1, 1, 1, 1, 1, 1, 1, 0, 2, 2], [0, -1]),
    ):
        assert matched_slots(truth, np.array([[labels]])).tolist() == [slots]


def test_the_slot_with_an_objects_pixels_follows_it(oracle_dataset: Path):
    clip = true_clip(oracle_dataset)
    shown = [row for row in range(clip.truth.count) if (clip.segmentation.labels == row + 1).any()]
    assert [(followed.row, followed.slot) for followed in clip.followed] == [(row, row) for row in shown]


def test_an_object_that_slots_share_or_that_shares_a_slot_is_not_followed(oracle_dataset: Path):
    clip = true_clip(oracle_dataset)
    labels = clip.segmentation.labels.clone()
    first = (labels == 1).nonzero()
    labels[tuple(first[::2].T)] = 3
    assert 0 not in {followed.row for followed in relabelled(clip, labels).followed}
    assert relabelled(clip, torch.ones_like(labels)).followed == []


def test_clips_of_several_cameras_are_refused(tmp_path: Path):
    stills = write_dataset(tmp_path / "stills", scenes=1, frames=1, views=2, size=(16, 12))
    with pytest.raises(UsageError, match="stills has 2 views; expected clips of one camera"):
        next(infer_clips(untrained(), stills, "test", 1))


def test_objects_begin_where_their_pixels_are(oracle_dataset: Path):
    clip = true_clip(oracle_dataset)
    rays = all_rays(clip.observation)
    for row in range(clip.truth.count):
        mine = torch.from_numpy(clip.truth.record["segmentation"][0]).flatten() == row + 1
        for step, inside in ((-0.003, False), (0.001, True)):
            points = (rays.origin + rays.direction * (rays.depth[..., None] + step))[0, 0, mine]
            # Along a grazing ray even a millimetre may leave the object again.
            assert (clip.occupied(row, 0, points) == inside).float().mean() > 0.8
