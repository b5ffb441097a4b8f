import numpy as np
import pytest

from benchmark.commands.segment import find_method
from benchmark.models.classical import CLASSICAL, STRONGER
from datagen.errors import UsageError
from tests.worlds.observations import labels_by_colour, table_scene


@pytest.mark.parametrize("name", [*CLASSICAL, *STRONGER])
def test_every_method_without_training_labels_the_objects(name: str):
    scene = table_scene(spheres=2, height=64, width=64)
    labels = find_method(name)(scene)
    assert labels.shape == scene.depth[0, :, 0].shape
    truth = labels_by_colour(scene.rgb[0, 0, 0]).numpy()
    for ball in (1, 2):
        own = labels[0][truth == ball]
        assert np.mean(own > 0) > 0.7
        assert np.mean(own == np.bincount(own[own > 0]).argmax()) > 0.5


def test_other_names_are_refused_with_a_suggestion():
    with pytest.raises(UsageError, match="did you mean 'plane-hdbscan'"):
        find_method("plane-hdbscn")
