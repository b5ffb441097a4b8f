from dataclasses import replace
from pathlib import Path

import pytest
import torch

from obpose.creation import refine as refining
from obpose.creation.edit import remove
from obpose.creation.infer import infer_scene
from obpose.creation.origin import Origin
from obpose.creation.refine import refine
from obpose.creation.scene import Scene
from obpose.geometry import all_rays
from obpose.losses.objective import observation_terms
from obpose.model import ObPose
from obpose.nerf.along import fields_along
from obpose.resolution import fitting_model
from obpose.types import Observation
from tests.obpose.creation.scenes import alike, equal, some_model
from tests.obpose.scenes import table_scene

STEPS = 12


@pytest.fixture(scope="module")
def model() -> ObPose:
    return some_model()


def clip(**options: float) -> Observation:
    return table_scene(batch=1, frames=2, height=20, width=20, **options)


def inferred(model: ObPose, observation: Observation) -> Scene:
    return infer_scene(Origin(model, Path("folder"), "name", "hash"), observation)


def explained(model: ObPose, observation: Observation, scene: Scene) -> float:
    """Loss of all pixels, with the weights that refinement gives it."""
    leaves = refining._Leaves(scene.what, scene.background, scene.center, scene.detail)
    with torch.no_grad():
        decoding = refining._decoding(model, scene, leaves)
        along = fields_along(all_rays(observation), decoding, model.config.loss, torch.Generator().manual_seed(3))
        terms = observation_terms(along, model.config.loss)
    loss = model.config.loss
    weights = {"colour": loss.colour, "surface": loss.surface, "air": refining.AIR * loss.air}
    return float(sum(weights[name] * term for name, term in terms.items()))


def parts(scene: Scene) -> tuple[torch.Tensor, ...]:
    return scene.what, scene.background, scene.center, scene.detail


def test_the_frames_are_explained_better_and_with_details_better_still(model: ObPose):
    observation = clip()
    before = inferred(model, observation)
    after = refine(model, observation, before, steps=STEPS)
    without = replace(after, detail=torch.zeros_like(after.detail))
    losses = [explained(model, observation, scene) for scene in (before, without, after)]
    assert losses[1] < losses[0] - 0.1
    assert losses[2] < losses[1]
    assert all(not torch.equal(one, other) for one, other in zip(parts(before), parts(after), strict=True))


def test_its_loss_at_the_start_is_that_of_what_was_inferred(model: ObPose):
    """The fields of the scene are those of the inference, everywhere."""
    observation = clip()
    model = fitting_model(model, observation)
    scene, inference = inferred(model, observation), model.segment(observation).inference
    rays, colours = all_rays(observation), "with"
    points = rays.origin + rays.direction * rays.depth[..., None]
    leaves = refining._Leaves(scene.what, scene.background, scene.center, scene.detail)
    with torch.no_grad():
        of_scene = refining._decoding(model, scene, leaves)(points, rays.direction, colours)
        of_model = model.decode(inference, points, rays.direction, colours)
    torch.testing.assert_close(of_scene.logits, of_model.logits)
    torch.testing.assert_close(of_scene.colours, of_model.colours)


def test_boxes_move_by_a_step_at_most_and_do_not_turn(model: ObPose):
    observation = clip()
    before = inferred(model, observation)
    after = refine(model, observation, before, steps=3)
    assert (after.center - before.center).abs().max() <= 3.1 * refining.PLACE_STEP
    assert torch.equal(after.rotation, before.rotation)


def test_it_repeats_and_leaves_the_model_and_what_it_was_given_alone(model: ObPose):
    observation = clip()
    scene = inferred(model, observation)
    given = replace(
        scene, **{name: getattr(scene, name).clone() for name in ("what", "background", "center", "detail")}
    )
    weights = [weight.detach().clone() for weight in model.parameters()]
    first, second = (refine(model, observation, scene, steps=3) for _ in range(2))
    assert alike(first, second)
    assert equal(scene, given)
    assert all(torch.equal(one, other) for one, other in zip(model.parameters(), weights, strict=True))
    assert all(weight.grad is None for weight in model.parameters())
    assert not any(value.requires_grad for value in parts(first))


def test_pixels_without_depth_have_no_say(model: ObPose):
    observation = clip(holes=0.3)
    scene = inferred(model, observation)
    other = replace(observation, rgb=torch.where(observation.valid[..., None], observation.rgb, 0.9))
    assert alike(*(refine(model, seen, scene, steps=3) for seen in (observation, other)))


def test_a_clip_without_any_depth_stays_as_it_was(model: ObPose):
    scene = inferred(model, clip())
    assert equal(refine(model, clip(holes=1.0), scene, steps=2), scene)


def test_without_steps_nothing_changes(model: ObPose):
    scene = inferred(model, clip())
    assert equal(refine(model, clip(), scene, steps=0), scene)


def test_a_scene_without_objects_has_its_background_fitted(model: ObPose):
    scene = inferred(model, clip())
    for name in scene.ids:
        scene = remove(scene, name)
    after = refine(model, clip(), scene, steps=2)
    assert after.ids == ()
    assert not torch.equal(after.background, scene.background)
