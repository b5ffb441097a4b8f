from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from obpose.geometry import all_rays, sample_rays_where, to_box, unproject
from obpose.model.losses.objective import observation_terms
from obpose.model.nerf.along import fields_along
from obpose.model.nerf.detail import Detail
from obpose.model.obpose import ObPose
from obpose.model.resolution import fitting_model
from obpose.scenes import refine as refining
from obpose.scenes.edit import remove
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.refine import refine
from obpose.scenes.scene import Scene
from obpose.types import Observation, Rays
from tests.obpose.scenes.small_scenes import alike, equal, some_model
from tests.worlds.observations import table_scene

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
    with torch.no_grad():
        decoding = refining.fields_of(model, scene)
        along = fields_along(all_rays(observation), decoding, torch.Generator().manual_seed(3))
        terms = observation_terms(along, model.config.loss)
    weights = {"colour": 1.0, "surface": 1.0, "air": refining.AIR}
    return float(sum(weights[name] * term for name, term in terms.items()))


def parts(scene: Scene) -> tuple[torch.Tensor, ...]:
    return scene.what, scene.background, scene.center, scene.appearance.detail


def test_half_of_the_rays_hit_objects(model: ObPose, monkeypatch: pytest.MonkeyPatch):
    """Objects are seen in a fifth of the pixels, and a fifth of the other half of the rays hit them too."""
    observation, hits = clip(), []
    objects = torch.zeros_like(observation.depth)
    objects[..., :4, :] = 1

    def watched(*place: Any, **options: Any) -> Rays:
        rays = sample_rays_where(*place, **options)
        points = (rays.origin + rays.direction * rays.depth[..., None]).flatten(0, -2)
        away = torch.cdist(points, unproject(observation)[objects > 0]).amin(dim=-1)
        hits.append(float((away < 2e-3).float().mean()))
        return rays

    monkeypatch.setattr(refining, "LEAST_RAYS", 300)
    monkeypatch.setattr(refining, "RAYS", 300)
    monkeypatch.setattr(refining, "_shows_objects", lambda observation, decoding: objects)
    monkeypatch.setattr(refining, "sample_rays_where", watched)
    refine(model, observation, inferred(model, observation), steps=1)
    assert hits == [pytest.approx(0.6, abs=0.08)]


def test_the_frames_are_explained_better_and_with_details_better_still(model: ObPose):
    observation = clip()
    before = inferred(model, observation)
    after = refine(model, observation, before, steps=STEPS)
    without = after.with_appearance(detail=torch.zeros_like(after.appearance.detail))
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
    with torch.no_grad():
        of_scene = refining.fields_of(model, scene)(points, rays.direction, colours)
        of_model = model.decode(inference, points, rays.direction, colours)
    torch.testing.assert_close(of_scene.logits, of_model.logits)
    torch.testing.assert_close(of_scene.colours, of_model.colours)


def test_details_are_added_to_the_fields_of_their_own_objects_in_all_frames(model: ObPose):
    observation = clip()
    scene = inferred(model, observation)
    detail = torch.randn(scene.appearance.detail.shape, generator=torch.Generator().manual_seed(0))
    points = scene.center + torch.tensor([0.02, 0.01, 0.0])
    points = replace_height(points)[None]
    with torch.no_grad():
        plain, changed = (
            refining.fields_of(model, each)(points, points, "without").logits
            for each in (scene, scene.with_appearance(detail=detail))
        )
    for frame in range(scene.frames):
        for place in range(len(scene.ids)):
            in_box = to_box(points[0, frame], scene.center[frame, place], scene.rotation[frame, place], 0.2)
            inside = (in_box.abs() <= 1).all(dim=-1)
            assert inside[place]
            added = (changed - plain)[0, frame, 1 + place, inside]
            torch.testing.assert_close(added, Detail(detail, torch.tensor(place)).of(in_box)[inside, 0])


def replace_height(points: torch.Tensor) -> torch.Tensor:
    """Above the table, below which objects are nowhere."""
    return torch.cat([points[..., :2], points[..., 2:].clamp(min=0.01)], dim=-1)


def test_objects_are_shown_where_their_boxes_hold_what_rises_above_the_table():
    """If their field is dense everywhere."""
    observation, model = clip(), some_model()
    with torch.no_grad():
        model.object_field.density_logit.bias.add_(20.0)
    points = unproject(observation)[0, :, 0]
    highest = points.flatten(1, 2)[torch.arange(2), points[..., 2].flatten(1).argmax(dim=1)]
    scene = inferred(model, observation)
    scene = replace(scene, center=highest[:, None].expand_as(scene.center))
    shown = refining._shows_objects(observation, refining.fields_of(model, scene))
    inside = [
        (to_box(points[frame].flatten(0, 1), scene.center[frame, 0], scene.rotation[frame, place], 0.2).abs() <= 1).all(
            -1
        )
        for frame in range(2)
        for place in range(len(scene.ids))
    ]
    expected = torch.stack(inside).view(2, len(scene.ids), 20, 20).any(dim=1) & (points[..., 2] > 0.001)
    assert 0 < expected.float().mean() < 0.5
    assert torch.equal(shown[0, :, 0] > 0, expected)


def test_boxes_move_by_a_step_at_most_and_do_not_turn(model: ObPose):
    observation = clip()
    before = inferred(model, observation)
    after = refine(model, observation, before, steps=3)
    assert (after.center - before.center).abs().max() <= 3.1 * refining.PLACE_STEP
    assert torch.equal(after.rotation, before.rotation)


def test_it_repeats_and_leaves_the_model_and_what_it_was_given_alone(model: ObPose):
    observation = clip()
    scene = inferred(model, observation)
    given = replace(scene, **{name: getattr(scene, name).clone() for name in ("what", "background", "center")})
    given = given.with_appearance(detail=scene.appearance.detail.clone())
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
