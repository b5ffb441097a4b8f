from dataclasses import replace

import pytest
import torch

from obpose.creation import refine as refining
from obpose.creation.refine import refine
from obpose.geometry import all_rays
from obpose.losses.objective import observation_terms
from obpose.model import ObPose
from obpose.nerf.along import fields_along
from obpose.types import Inference, Observation
from tests.obpose.creation.scenes import some_model
from tests.obpose.scenes import table_scene

STEPS = 12


@pytest.fixture(scope="module")
def model() -> ObPose:
    return some_model()


def clip(**options: float) -> Observation:
    return table_scene(batch=1, frames=2, height=20, width=20, **options)


def explained(model: ObPose, observation: Observation, inference: Inference) -> float:
    """Loss of all pixels, without weights."""
    with torch.no_grad():
        generator = torch.Generator().manual_seed(3)
        along = fields_along(
            all_rays(observation), lambda *at: model.decode(inference, *at), model.config.loss, generator
        )
        return float(sum(observation_terms(along, model.config.loss).values()))


def places(inference: Inference) -> tuple[torch.Tensor, ...]:
    assert inference.background is not None
    return inference.what.z, inference.background.z, inference.boxes.center


def test_the_frames_are_explained_better(model: ObPose):
    observation = clip()
    before = model.segment(observation).inference
    after = refine(model, observation, before, steps=STEPS)
    assert explained(model, observation, after) < explained(model, observation, before) - 0.1
    assert all(not torch.equal(one, other) for one, other in zip(places(before), places(after), strict=True))


def test_boxes_move_by_a_step_at_most_and_do_not_turn(model: ObPose):
    observation = clip()
    before = model.segment(observation).inference
    after = refine(model, observation, before, steps=3)
    assert (after.boxes.center - before.boxes.center).abs().max() <= 3.1 * refining.PLACE_STEP
    assert torch.equal(after.boxes.rotation, before.boxes.rotation)


def test_it_repeats_and_leaves_the_model_and_what_it_was_given_alone(model: ObPose):
    observation = clip()
    inference = model.segment(observation).inference
    given = [value.clone() for value in places(inference)]
    weights = [weight.detach().clone() for weight in model.parameters()]
    first, second = (refine(model, observation, inference, steps=3) for _ in range(2))
    assert all(torch.equal(one, other) for one, other in zip(places(first), places(second), strict=True))
    assert all(torch.equal(one, other) for one, other in zip(places(inference), given, strict=True))
    assert all(torch.equal(one, other) for one, other in zip(model.parameters(), weights, strict=True))
    assert all(weight.grad is None for weight in model.parameters())
    assert not any(value.requires_grad for value in places(first))


def test_pixels_without_depth_have_no_say(model: ObPose):
    observation = clip(holes=0.3)
    inference = model.segment(observation).inference
    other = replace(observation, rgb=torch.where(observation.valid[..., None], observation.rgb, 0.9))
    one, two = (refine(model, seen, inference, steps=3) for seen in (observation, other))
    assert all(torch.equal(a, b) for a, b in zip(places(one), places(two), strict=True))


def test_a_clip_without_any_depth_stays_as_it_was(model: ObPose):
    observation = clip(holes=1.0)
    inference = model.segment(observation).inference
    after = refine(model, observation, inference, steps=2)
    assert all(torch.equal(a, b) for a, b in zip(places(after), places(inference), strict=True))
