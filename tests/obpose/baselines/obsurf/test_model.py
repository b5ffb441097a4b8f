"""The model as a whole: what each part does is tested with the part."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from obpose.baselines.obsurf.config import OBSURF_VARIANTS
from obpose.baselines.obsurf.losses import SIGMA_MAX
from obpose.baselines.obsurf.model import JITTER, Encoded, Obsurf
from obpose.data.clips import random_view, separate_views
from obpose.geometry import all_rays, sample_rays, unproject
from obpose.systems import find_system
from obpose.types import Observation
from tests.worlds.observations import table_scene

DEPTH = "obsurf-no-overlap-depth"


def made(variant: str = "obsurf", **changes: Any) -> Obsurf:
    torch.manual_seed(0)
    small = {"model.encoder.width": 16, "model.decoder.width": 16, "train.rays": 64}
    return Obsurf(find_system(variant).config("cpu", {**small, **changes}))


def spread_out(variant: str = "obsurf", **changes: Any) -> Obsurf:
    """Slots that differ enough to share the pixels among them."""
    model = made(variant, **{"model.decoder.unit_scales": True, **changes})
    with torch.no_grad():
        for layer in model.field.scales:
            layer.weight.mul_(3)
    return model.eval()


def noise(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def losses(model: Obsurf, scene: Observation, fraction: float = 0.5, seed: int = 0) -> dict[str, Tensor]:
    return model.train().losses(scene, step=5, fraction=fraction, generator=noise(seed))


@pytest.mark.parametrize("variant", OBSURF_VARIANTS)
def test_every_weight_learns(variant: str):
    model = made(variant)
    terms = losses(model, table_scene(batch=2, views=2))
    assert set(terms) == {"total", "colour", "surface", "air"} | ({"overlap"} if variant == "obsurf" else set())
    assert all(value.isfinite() for value in terms.values())
    terms["total"].backward()
    assert [name for name, weight in model.named_parameters() if weight.grad is None or not weight.grad.any()] == []


def test_colours_teach_the_layers_that_densities_share_with_them_by_themselves():
    model = made()
    with torch.no_grad():
        model.field.density_logit.weight.zero_()
    losses(model, table_scene())["total"].backward()
    shared = (model.field.shifts, model.field.scales, model.field.hidden)
    gradients = [weight.grad for layers in shared for weight in layers.parameters()]
    assert all(gradient is not None and gradient.any() for gradient in gradients)


def test_the_total_is_the_weighted_sum_with_the_overlap_as_far_as_it_has_grown():
    model = made(**{"loss.overlap": 0.1})
    for fraction, share in ((0.1, 0.0), (0.3, 0.5), (0.9, 1.0)):
        terms = losses(model, table_scene(), fraction)
        weighted = terms["colour"] + terms["surface"] + terms["air"] + share * 0.1 * terms["overlap"]
        torch.testing.assert_close(terms["total"].detach(), weighted)


def test_losses_repeat_with_their_generator_and_each_step_has_other_slots():
    model, scene = made(), table_scene()
    one, same, other = (losses(model, scene, seed=seed)["total"] for seed in (0, 0, 1))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_one_view_is_the_input_and_all_are_supervised(monkeypatch: pytest.MonkeyPatch):
    model, scene = made(), table_scene(views=3, frames=2, batch=4)
    inputs: list[Observation] = []
    drawn: list[Tensor] = []
    encode = Obsurf.encode

    def spy(self: Obsurf, observation: Observation, given: Tensor):
        inputs.append(observation)
        return encode(self, observation, given)

    def spy_rays(observation: Observation, count: int, generator: torch.Generator | None):
        rays = sample_rays(observation, count, generator)
        drawn.append(rays.index // (32 * 32))
        return rays

    monkeypatch.setattr(Obsurf, "encode", spy)
    monkeypatch.setattr("obpose.baselines.obsurf.model.sample_rays", spy_rays)
    chosen = set()
    for seed in range(3):
        losses(model, scene, seed=seed)
        for clip in range(4):
            match = [view for view in range(3) if torch.equal(inputs[-1].rgb[clip, :, 0], scene.rgb[clip, :, view])]
            assert torch.equal(inputs[-1].world_from_camera[clip, 0], scene.world_from_camera[clip, match[0]])
            chosen.add(match[0])
    assert inputs[0].depth.shape == (4, 2, 1, 32, 32)
    assert chosen == {0, 1, 2}
    assert drawn[0].unique().tolist() == [0, 1, 2]


def test_more_rays_can_be_drawn_where_the_densest_slot_is_not():
    """Each still weighs as much as it has to for means over all pixels."""
    model, scene = spread_out(**{"train.object_rays": 0.8, "train.rays": 900}), table_scene(views=2, holes=0.1)
    with torch.no_grad():  # slots that fresh weights tell apart but a little
        model.field.density_logit.weight.mul_(1e3)
        model.field.density_logit.bias.sub_(1e2)
    encoded = model.encode(random_view(scene, noise()), model.attention.evaluation_noise[None].expand(2, -1, -1))
    rays = all_rays(scene)
    logits, _ = model._densities(encoded, rays.origin + rays.direction * rays.depth[..., None])
    owners = logits.argmax(dim=2).masked_fill(~rays.valid, -1)
    drawn = model._sample_rays(scene, encoded, noise())
    assert drawn.valid.all()
    for frame in range(2):
        largest = owners[0, frame][rays.valid[0, frame]].mode().values
        elsewhere = owners[0, frame] != largest
        there = elsewhere[drawn.index[0, frame]]
        share = elsewhere[rays.valid[0, frame]].float().mean().item()
        assert 0.02 < share < 0.6
        assert there.float().mean() > 1.3 * share
        weight = drawn.weight[0, frame]
        assert ((weight * there).sum() / weight.sum()).item() == pytest.approx(share, rel=0.15)


@pytest.mark.parametrize("variant", ["obsurf", DEPTH])
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_depths_that_are_not_valid_have_no_influence(variant: str, share: float):
    model, scene = spread_out(variant, **{"train.object_rays": share}), table_scene(holes=0.2, views=2)
    spoiled = replace(scene, depth=torch.where(scene.valid, scene.depth, 7.7))
    plain, other = model.segment(scene), model.segment(spoiled)
    assert torch.equal(plain.labels, other.labels)
    assert not plain.labels[~scene.valid].any()
    assert losses(model, scene)["total"].item() == losses(model, spoiled)["total"].item()


def test_the_encoder_is_given_points_in_units_where_there_are_any_and_zeros_elsewhere():
    middle = (0.3, -0.2, 0.1)
    model, scene = made(DEPTH, **{"model.workspace_center": middle}), table_scene(holes=0.3, frames=1)
    seen: list[Tensor] = []
    model.encoder.register_forward_pre_hook(lambda _, given: seen.append(given[2]))
    model.segment(scene)
    (points,), valid = seen[0], scene.valid[0, 0, 0]
    assert not points[~valid].any()
    torch.testing.assert_close(
        points[valid], torch.cat([_in_units(scene, middle)[valid], torch.ones(valid.sum(), 1)], -1)
    )


def test_the_encoder_is_given_rays_of_unit_length():
    model, scene = made(), table_scene(frames=1)
    seen: list[Tensor] = []
    model.encoder.register_forward_pre_hook(lambda _, given: seen.append(given[1]))
    model.segment(scene)
    toward = (unproject(scene) - scene.world_from_camera[:, None, :, None, None, :3, 3])[0, 0, 0]
    torch.testing.assert_close(seen[0][0], toward / toward.norm(dim=-1, keepdim=True))


def test_colours_mind_where_a_ray_goes_but_not_how_long_its_direction_is():
    model, scene = made(), table_scene(frames=1)
    encoded, rays = model.encode(scene, model.attention.evaluation_noise[None]), all_rays(scene)
    points = rays.origin + rays.direction * rays.depth[..., None]
    _, hidden = model._densities(encoded, points)
    plain, longer, turned = (
        model._colours(encoded, hidden, points, replace(rays, direction=times * rays.direction)) for times in (1, 3, -1)
    )
    torch.testing.assert_close(plain, longer)
    assert not torch.allclose(plain, turned)


def _in_units(scene: Observation, middle: tuple[float, float, float]) -> Tensor:
    return 10 * (unproject(scene)[0, 0, 0] - torch.tensor(middle))


def test_a_scene_without_any_depth_is_background():
    scene = table_scene(holes=1.0)
    assert not spread_out(DEPTH).segment(scene).labels.any()
    terms = losses(made(DEPTH), scene)
    terms["total"].backward()
    assert all(value.isfinite() for value in terms.values())


@pytest.mark.parametrize("variant", ["obsurf", DEPTH])
def test_scenes_frames_and_views_do_not_depend_on_each_other(variant: str):
    model, scene = spread_out(variant), table_scene(batch=2, frames=2, views=3, holes=0.1)
    whole = model.segment(scene)
    apart = model.segment(separate_views(scene))
    for clip, view, frame in ((0, 0, 0), (1, 2, 1), (1, 0, 1)):
        alone = Observation(
            *(getattr(scene, name)[clip, frame, view][None, None, None] for name in ("rgb", "depth", "valid")),
            *(getattr(scene, name)[clip, view][None, None] for name in ("k", "world_from_camera")),
        )
        found = model.segment(alone).labels[0, 0, 0]
        assert (found != whole.labels[clip, frame, view]).float().mean() < 0.005
        assert (found != apart.labels[3 * clip + view, frame, 0]).float().mean() < 0.005


def test_the_largest_slot_of_each_image_is_zero():
    model, scene = spread_out(), table_scene(batch=2, frames=2, views=2, holes=0.1)
    for _ in range(2):  # whichever slot it is
        found = model.segment(scene)
        assert found.labels.unique().numel() > 1
        for image in found.labels.flatten(0, 2):
            assert image.flatten().bincount().argmax() == 0
        model.attention.evaluation_noise.copy_(model.attention.evaluation_noise.roll(1, dims=0))


def test_labels_are_those_of_the_densest_slot_at_the_surface():
    model, scene = spread_out(), table_scene(frames=1)
    labels = model.segment(scene).labels[0, 0, 0]
    encoded = model.encode(scene, model.attention.evaluation_noise[None])
    rays = sample_rays(scene, 0, None)
    densities = model._densities(encoded, rays.origin + rays.direction * rays.depth[..., None])[0][0, 0]
    slots = densities.argmax(dim=0).view_as(labels)
    for label in labels.unique():
        assert slots[labels == label].unique().numel() == 1


def test_segmenting_twice_gives_the_same_whatever_the_global_generator():
    model, scene = spread_out(), table_scene()
    torch.manual_seed(1)
    first = model.segment(scene)
    torch.manual_seed(2)
    second = model.segment(scene)
    assert torch.equal(first.labels, second.labels)
    assert torch.equal(first.attention, second.attention)
    assert first.attention.unique().numel() > 1


def test_a_scene_of_another_size_in_metres_is_the_same_in_units():
    """Twice as far away, twice as large: the same densities, and the same losses."""
    small = table_scene()
    poses = small.world_from_camera.clone()
    poses[..., :3, 3] *= 2
    large = replace(small, depth=2 * small.depth, world_from_camera=poses)
    one, other = made(DEPTH), made(DEPTH, **{"model.units_per_metre": 5.0})
    for name, value in losses(one, small).items():
        torch.testing.assert_close(value, losses(other, large)[name], rtol=1e-3, atol=1e-4)


def test_the_way_through_the_air_is_as_long_as_the_ray_in_units():
    """The estimate is unbiased: near and far samples have the mean of the whole way."""
    changes = {"train.rays": 0, "model.units_per_metre": 4.0}
    model, scene = made(**changes), table_scene()
    with torch.no_grad():
        model.field.density_logit.weight.zero_()
        model.field.density_logit.bias.zero_()
    density = model.config.model.segments * SIGMA_MAX / 2
    rays = all_rays(scene)
    metres = (rays.direction * rays.depth[..., None]).norm(dim=-1).mean().item()
    assert losses(model, scene)["air"].item() == pytest.approx(density * 4 * metres, rel=0.05)


def test_surfaces_are_looked_for_up_to_the_jitter_behind_them_in_units(monkeypatch: pytest.MonkeyPatch):
    model, scene = made(**{"model.units_per_metre": 4.0, "train.rays": 0}), table_scene(frames=1)
    points: list[Tensor] = []
    densities = model._densities

    def spy(encoded: Encoded, given: Tensor):
        points.append(given)
        return densities(encoded, given)

    monkeypatch.setattr(model, "_densities", spy)
    losses(model, scene)
    rays = sample_rays(scene, 0, None)
    behind = (points[0] - rays.origin).norm(dim=-1) / rays.direction.norm(dim=-1) - rays.depth
    assert behind.min() >= -1e-5
    assert 0.016 < behind.max() <= JITTER / 4 + 1e-5


def test_what_is_behind_the_input_camera_has_no_features_from_it(monkeypatch: pytest.MonkeyPatch):
    model, scene = made(), table_scene(frames=1)
    seen: list[Tensor] = []
    colour = model.field.colour

    def spy(hidden: Tensor, directions: Tensor, pixels: Tensor) -> Tensor:
        seen.append(pixels)
        return colour(hidden, directions, pixels)

    monkeypatch.setattr(model.field, "colour", spy)
    encoded = model.encode(scene, model.attention.evaluation_noise[None])
    rays = sample_rays(scene, 64, noise())
    for share, there in ((1.0, True), (-1.0, False)):
        points = rays.origin + share * rays.direction * rays.depth[..., None]
        model._colours(encoded, model._densities(encoded, points)[1], points, rays)
        assert bool(seen[-1].any(dim=-1).all()) is there
    column, row = 10.5, 20.5  # of a pixel in the sixth column and eleventh row of cells
    pixel = torch.tensor([column, row, 1.0])
    camera = scene.world_from_camera[0, 0]
    point = camera[:3, :3] @ (torch.linalg.inv(scene.k[0, 0]) @ pixel) + camera[:3, 3]
    one = point.view(1, 1, 1, 3)
    ray = sample_rays(scene, 1, noise())
    model._colours(encoded, model._densities(encoded, one)[1], one, ray)
    assert torch.equal(seen[-1][0, 0], encoded.features[0, 10, 5])
