import pytest
import torch

from obpose.model.build import build_obpose
from obpose.model.obpose import ObPose
from obpose.model.resolution import TOLERANCE, fitting_model, surface_spacing
from obpose.variants import make_config
from tests.worlds.observations import table_scene


@pytest.fixture(scope="module")
def model() -> ObPose:
    spacing = surface_spacing(table_scene(height=32, width=32))
    return build_obpose(make_config(**{"model.spacing": spacing})).eval()


def test_twice_the_pixels_are_half_as_far_apart():
    coarse, fine = (surface_spacing(table_scene(height=size, width=size)) for size in (32, 64))
    assert coarse
    assert fine
    assert coarse / fine == pytest.approx(2, rel=0.03)


def test_nothing_seen_has_no_spacing(model: ObPose):
    nothing = table_scene(holes=1.0)
    assert surface_spacing(nothing) is None
    assert fitting_model(model, nothing) is model


def test_images_like_those_of_the_training_get_the_model_itself(model: ObPose):
    for seed in range(3):
        assert fitting_model(model, table_scene(seed=seed, holes=0.2)) is model


def test_others_get_the_same_weights_with_other_neighbourhoods(model: ObPose):
    images = table_scene(height=64, width=64)
    scaled = fitting_model(model, images)
    assert model.config.model.spacing / scaled.config.model.spacing > TOLERANCE
    assert scaled.config.model.spacing == surface_spacing(images)
    assert all(mine is theirs for mine, theirs in zip(model.parameters(), scaled.parameters(), strict=True))
    assert not torch.equal(scaled.infer(images).embeddings.features, model.infer(images).embeddings.features)
    assert scaled.segment(images).labels.shape == images.depth.shape
