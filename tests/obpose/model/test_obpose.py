"""The model as a whole: what each part does is tested with the part."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from obpose.geometry import unproject
from obpose.model.build import build_obpose
from obpose.model.obpose import ObPose
from obpose.model.perception import pixel_owners
from obpose.types import Masks, Observation, SceneSegmentation
from obpose.variants import VARIANTS, make_config
from tests.worlds.observations import labels_by_colour, table_scene

CONDITIONED = ("obpose", "obpose-loc", "obpose-none", "ic-sbp", "slot-attention")


def _model(variant: str = "obpose", **changes: Any) -> ObPose:
    """Untrained, but that its pre-scope expects objects everywhere."""
    torch.manual_seed(0)
    model = build_obpose(make_config(variant, **{"model.spacing": 0.024, **changes}))
    if model.heads.prescope is not None:
        with torch.no_grad():
            model.heads.prescope[-1].bias.copy_(torch.tensor([0.0, 5.0]))
    return model


def _part(observation: Observation, **places: slice) -> Observation:
    """Select scenes (`batch`) or frames (`frame`)."""
    batch, frame = places.get("batch", slice(None)), places.get("frame", slice(None))
    images = {name: getattr(observation, name)[batch, frame] for name in ("rgb", "depth", "valid")}
    return Observation(**images, k=observation.k[batch], world_from_camera=observation.world_from_camera[batch])


def _objects_alone(**options: Any) -> Observation:
    """Only what stands on the table has a depth."""
    scene = table_scene(**options)
    above = scene.valid & (unproject(scene)[..., 2] > 0.005)
    return replace(scene, depth=scene.depth * above, valid=above)


def _told(segmentation: SceneSegmentation) -> tuple[torch.Tensor, ...]:
    """All inferred arrays, scene by scene."""
    inference = segmentation.inference
    masks, boxes = inference.masks.log_masks.exp(), inference.boxes.center
    background = () if inference.background is None else (inference.background.mean,)
    return masks, boxes, inference.what.mean, *background


@pytest.mark.parametrize("variant", CONDITIONED)
def test_a_scene_does_not_depend_on_its_batch_mates(variant: str):
    model, scenes = _model(variant).eval(), table_scene(batch=3, holes=0.2)
    together, alone = model.segment(scenes), model.segment(_part(scenes, batch=slice(1, 2)))
    # To rounding; labels may differ where two fields are as dense as each other.
    assert (together.labels[1:2] != alone.labels).float().mean() < 0.005
    for mine, own in zip(_told(together), _told(alone), strict=True):
        torch.testing.assert_close(mine[1:2], own, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("variant", CONDITIONED)
def test_later_frames_have_no_influence_on_earlier_ones(variant: str):
    model, clip = _model(variant).eval(), table_scene(frames=3)
    whole, start = model.segment(clip), model.segment(_part(clip, frame=slice(2)))
    assert (whole.labels[:, :2] != start.labels).float().mean() < 0.005
    torch.testing.assert_close(whole.inference.what.mean[:, :2], start.inference.what.mean, rtol=1e-3, atol=1e-4)


def test_what_pixels_without_depth_look_like_does_not_matter():
    model, scene = _model().eval(), table_scene(holes=0.2)
    spoiled = replace(scene, rgb=torch.where(scene.valid[..., None], scene.rgb, 0.9))
    plain, other = model.segment(scene), model.segment(spoiled)
    assert torch.equal(plain.labels, other.labels)
    assert torch.equal(plain.inference.what.mean, other.inference.what.mean)
    assert torch.equal(plain.inference.background.mean, other.inference.background.mean)
    assert (plain.labels[~scene.valid] == 0).all()


@pytest.mark.parametrize("variant", CONDITIONED)
def test_what_pixels_without_depth_look_like_is_not_learned(variant: str):
    model, scene = _model(variant).train(), table_scene(holes=0.2)
    spoiled = replace(scene, rgb=torch.where(scene.valid[..., None], scene.rgb, 0.9))
    plain, other = (
        model.losses(each, step=500, generator=torch.Generator().manual_seed(0)) for each in (scene, spoiled)
    )
    assert plain.keys() == other.keys()
    assert all(torch.equal(value, other[name]) for name, value in plain.items())


def test_segmenting_twice_gives_the_same_whatever_the_global_generator():
    model, scene = _model().eval(), table_scene()
    torch.manual_seed(1)
    first = model.segment(scene)
    torch.manual_seed(2)
    second = model.segment(scene)
    assert torch.equal(first.labels, second.labels)
    assert torch.equal(first.attention, second.attention)


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_weight_learns_from_a_step_after_the_warmup(variant: str):
    model = _model(variant, **{"train.warmup": 3, "model.attention.inactive_in_training": "never"}).train()
    losses = model.losses(
        _objects_alone(batch=2, frames=4, spheres=3), step=3, generator=torch.Generator().manual_seed(0)
    )
    losses["total"].backward()
    assert all(value.isfinite() for value in losses.values())
    without = [name for name, weight in model.named_parameters() if weight.grad is None or not weight.grad.any()]
    assert without == []


def test_in_the_warmup_nothing_of_an_object_is_touched():
    model = _model().train()
    losses = model.losses(table_scene(), step=0, generator=torch.Generator().manual_seed(0))
    losses["total"].backward()
    assert set(losses) == {"total", "colour", "surface", "air", "attention", "kl_background"}
    of_objects = ("where", "what", "object_field", "attention")
    assert all(
        weight.grad is None for name, weight in model.named_parameters() if name.split(".")[0].startswith(of_objects)
    )
    assert model.background_field.first.weight.grad is not None


def test_losses_repeat_with_their_generator():
    model, scene = _model().train(), table_scene()
    one, same, other = (
        model.losses(scene, step=500, generator=torch.Generator().manual_seed(seed))["total"] for seed in (0, 0, 1)
    )
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_without_conditioning_every_box_is_the_workspace_and_location_alone_turns_none():
    scene = _objects_alone(height=64, width=64)
    nowhere = _model("obpose-none").infer(scene)
    assert nowhere.where is None
    assert nowhere.boxes.size == _model().config.model.workspace_size
    assert nowhere.boxes.center.eq(0).all()
    located = _model("obpose-loc").infer(scene)
    assert torch.equal(located.boxes.rotation, torch.eye(3).expand_as(located.boxes.rotation))
    turned = _model("obpose").infer(scene)
    assert not torch.equal(turned.boxes.rotation, torch.eye(3).expand_as(turned.boxes.rotation))


def test_boxes_are_no_farther_from_the_observed_centers_than_t_max():
    model = _model(**{"model.pose.max_translation": 0.02})
    assert model.where
    with torch.no_grad():
        for weight in model.where.parameters():
            weight.mul_(100)
    inference = model.infer(table_scene())
    assert 0.015 < (inference.boxes.center - inference.observed_center).abs().max() <= 0.02 + 1e-6


def test_fields_move_no_boxes():
    model, scene = _model(), table_scene()
    inference = model.infer(scene)
    center = inference.boxes.center.detach().requires_grad_()
    inference = replace(inference, boxes=replace(inference.boxes, center=center))
    points = center.detach() + torch.tensor([0.01, 0.02, 0.05])
    logits = model.decode(inference, points, points).logits
    (gradient,) = torch.autograd.grad(logits[:, :, 1:].sum(), center, allow_unused=True)
    assert gradient is None


def test_views_are_one_cloud_whose_order_does_not_matter():
    # Posteriors of fields of which nothing is learned are ties, which rounding decides.
    model = _model(**{"model.attention.posterior_refinements": 0}).eval()
    scene = table_scene(views=3, frames=1)
    order = torch.tensor([2, 0, 1])
    images = {name: getattr(scene, name)[:, :, order] for name in ("rgb", "depth", "valid")}
    cameras = {name: getattr(scene, name)[:, order] for name in ("k", "world_from_camera")}
    plain, turned = model.segment(scene), model.segment(Observation(**images, **cameras))
    torch.testing.assert_close(plain.inference.boxes.center, turned.inference.boxes.center, rtol=0, atol=1e-4)
    torch.testing.assert_close(plain.inference.background.mean, turned.inference.background.mean, rtol=0, atol=1e-4)
    assert (plain.labels[:, :, order] != turned.labels).float().mean() < 0.005


def test_a_scene_without_any_depth_is_background():
    scene = table_scene(holes=1.0)
    assert _model().eval().segment(scene).labels.eq(0).all()
    losses = _model().train().losses(scene, step=500, generator=torch.Generator().manual_seed(0))
    losses["total"].backward()
    assert all(value.isfinite() for value in losses.values())


@pytest.mark.parametrize("variant", ["ic-sbp", "slot-attention"])
def test_systems_without_boxes_have_as_many_components_as_the_others(variant: str):
    model, slots = _model(variant).eval(), make_config().model.slots
    segmentation = model.segment(table_scene())
    components = segmentation.inference.masks.log_masks.shape[2]
    if variant == "ic-sbp":
        assert (model.background_slot, components) == (None, 1 + slots + 1)
        assert segmentation.inference.background is None
        assert segmentation.labels.min() > 0, "Label 0 is of no slot."
    else:
        assert (model.background_slot, components) == (0, 1 + slots)


def test_slot_attention_can_be_warmed_up_by_its_background_alone():
    model = _model("slot-attention", **{"train.warmup": 3}).train()
    losses = model.losses(table_scene(), step=0, generator=torch.Generator().manual_seed(0))
    losses["total"].backward()
    assert set(losses) == {"total", "colour", "surface", "air", "kl_background"}
    assert all(weight.grad is None for weight in model.object_field.parameters())


def test_cells_without_a_point_have_no_say_in_whose_a_pixel_is():
    """On a grid of half the resolution, of which every other column was not observed."""
    model, scene = _model(**{"model.backbone.output_level": 1}), table_scene(frames=1)
    valid = torch.zeros(1, 1, 16, 16, dtype=torch.bool)
    valid[..., ::2] = valid[..., -1] = True
    shares = torch.where(valid, 0.6, 0.0).flatten(2)
    log_masks = torch.stack([1 - shares, shares], dim=2).log()
    masks = Masks(log_masks, log_scope=torch.zeros(1, 1, 256), active=torch.ones(1, 1, dtype=torch.bool))
    grid = model.backbone.grid_size(32, 32)
    assert (pixel_owners(masks, valid.flatten(2), scene, grid=grid) == 1).all()


@pytest.mark.parametrize("variant", ["ic-sbp", "slot-attention", "obpose"])
@pytest.mark.parametrize("loss", ["mixture", "l2"])
def test_both_attention_losses_teach_the_masks_of_every_system(variant: str, loss: str):
    """With a weight beside which the other terms are negligible."""
    gradients = []
    for weight in (0.0, 1e6):
        model = _model(variant, **{"loss.attention": loss, "train.warmup": 0, "loss.attention_weight": weight}).train()
        model.losses(table_scene(), step=1, generator=torch.Generator().manual_seed(0))["total"].backward()
        parts = model.attention, model.backbone, model.object_field
        norms = [sum(float(w.grad.norm()) for w in part.parameters() if w.grad is not None) for part in parts]
        gradients.append(norms)
    (attention, backbone, field), (more_attention, more_backbone, same_field) = gradients
    assert more_attention > 100 * attention
    assert more_backbone > 100 * backbone
    assert same_field == pytest.approx(field, rel=1e-3)


def test_observed_colours_can_be_left_out_of_the_features():
    with_them, without = _model().infer(table_scene()), _model(**{"model.latent.colours": "none"}).infer(table_scene())
    assert with_them.embeddings.features.shape[-1] == without.embeddings.features.shape[-1] + 3


def test_the_air_weighs_more_towards_the_end_of_the_budget():
    model, scene = _model(**{"loss.air_growth": 9.0}), table_scene()
    early, late, last = (
        model.losses(scene, step=1000, fraction=fraction, generator=torch.Generator().manual_seed(0))
        for fraction in (0.5, 0.625, 1.0)
    )
    assert torch.equal(early["air"], last["air"])
    torch.testing.assert_close(late["total"] - early["total"], 2 * early["air"])
    torch.testing.assert_close(last["total"] - early["total"], 8 * early["air"])


def test_views_that_are_not_encoded_have_no_say_in_what_is_inferred():
    scene = table_scene(views=3, frames=1)
    model = _model(**{"train.views": "random"})
    terms = [
        model.losses(changed, step=1000, generator=_drawing_the_first_view())
        for changed in (scene, _other_colours(scene, view=slice(1, 3)))
    ]
    for name in ("attention", "kl_what", "kl_background", "scope"):
        torch.testing.assert_close(terms[0][name], terms[1][name])
    assert not torch.allclose(terms[0]["colour"], terms[1]["colour"])


def _other_colours(scene: Observation, *, view: slice) -> Observation:
    rgb = scene.rgb.clone()
    rgb[:, :, view] = 1 - rgb[:, :, view]
    return replace(scene, rgb=rgb)


def _drawing_the_first_view() -> torch.Generator:
    for seed in range(100):
        generator = torch.Generator().manual_seed(seed)
        if torch.randint(3, (1,), generator=generator).item() == 0:
            return generator.manual_seed(seed)
    raise AssertionError


@pytest.mark.parametrize("variant", ["obpose", "obpose-loc"])
@pytest.mark.parametrize("level", [0, 1])
def test_given_masks_become_the_objects(variant: str, level: int):
    model = _model(variant, **{"model.backbone.output_level": level}).eval()
    scene = table_scene(spheres=3, height=64, width=64)
    labels = torch.stack([labels_by_colour(rgb) for rgb in scene.rgb]) * 2
    found = model.segment(scene, labels)
    assert torch.equal(found.labels, labels * scene.valid)
    count = int(labels.max())
    assert found.inference.masks.active[0].tolist() == [name % 2 == 0 for name in range(1, count + 1)]
    points = unproject(scene)[0, 0, 0]
    for name in range(2, count + 1, 2):
        mean = points[labels[0, 0, 0] == name].mean(dim=0)
        torch.testing.assert_close(
            found.inference.observed_center[0, 0, name - 1], mean, atol=0.01 + 0.02 * level, rtol=0
        )
