from dataclasses import fields

import pytest
import torch

from obpose.baselines.supervised import Supervised
from obpose.contact.config import SupervisedConfig
from obpose.contact.images import images_of
from obpose.data.clips import ArrayClips, LabelledArrayClips, stack
from obpose.errors import UsageError
from obpose.types import LabelledObservation
from tests.worlds.observations import labels_by_colour, table_scene
from tests.worlds.sphere_clips import clip_and_truth


def test_the_labels_of_the_dataset_are_what_it_learns():
    scene = table_scene(frames=2, spheres=2)
    labels = torch.stack([labels_by_colour(rgb) for rgb in scene.rgb])
    parts = {field.name: getattr(scene, field.name) for field in fields(scene)}
    observation = LabelledObservation(**parts, segmentation=labels)
    images = images_of(observation, center=torch.zeros(3), table=0.0)
    assert torch.equal(images.labels, labels.flatten(0, 2) * observation.valid.flatten(0, 2))
    model = Supervised(SupervisedConfig())
    one, other = (
        model.losses(
            LabelledObservation(**parts, segmentation=given), step=0, generator=torch.Generator().manual_seed(0)
        )
        for given in (labels, torch.zeros_like(labels))
    )
    assert one["foreground"] != other["foreground"]


def test_clips_without_labels_are_refused():
    clip, truth = clip_and_truth(0, uses_labels=True)
    model = Supervised(SupervisedConfig())
    for source in (ArrayClips([clip]), LabelledArrayClips([clip])):
        assert model.training_source(source) is source
    labelled = stack([LabelledArrayClips([clip]).window(0, 0, 1)], model.observation_type)
    assert torch.equal(labelled["segmentation"][0, 0], torch.from_numpy(truth[0].astype("int64")))
    with pytest.raises(UsageError, match="which this model learns from"):
        stack([ArrayClips([clip]).window(0, 0, 1)], model.observation_type)
