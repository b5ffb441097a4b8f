from typing import Literal

import pytest
import torch

from obpose.data.clips import observation_of
from obpose.data.labels import segment_clip
from tests.obpose.toy import ToyClips, ToyModel, toy_config


@pytest.mark.parametrize("views", ["all", "separate"])
def test_labels_are_a_map_of_every_frame_and_view(views: Literal["all", "separate"]):
    window = ToyClips(views=3, labels=True).window(1, 0, 4)
    labels = segment_clip(ToyModel(toy_config()), observation_of([window]), views)
    assert labels.shape == (4, 3, 8, 8)
    assert torch.equal(torch.from_numpy(labels), (window["segmentation"] > 0).long())


def test_views_apart_are_segmented_each_alone():
    seen = []

    class Watched(ToyModel):
        def segment(self, observation):
            seen.append(tuple(observation.depth.shape))
            return super().segment(observation)

    window = observation_of([ToyClips(views=3).window(1, 0, 4)])
    segment_clip(Watched(toy_config()), window, "separate")
    assert seen == [(3, 4, 1, 8, 8)]
