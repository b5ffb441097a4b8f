import dataclasses
from typing import Any, Literal

import pytest
import torch

from obpose.config import LatentConfig
from obpose.model.layers.kpconv import EXTENT
from obpose.model.pose.crop import BoxSamples
from obpose.model.pose.encoder import NEIGHBOURS, Neighbourhoods, ObjectEncoder, neighbourhoods
from tests.obpose.model.pose.clouds import crop, half_a_cube, table

FEATURES, WIDTH = 4, 32
RADIUS = LatentConfig().radius
NOTHING = torch.zeros(0, 3)
SPARSE, DENSE = 0.025, 0.012
"""Metres between points of the embedding grids, 32 and 64 cells wide."""


def encoder(**values: Any) -> ObjectEncoder:
    torch.manual_seed(0)
    return ObjectEncoder(FEATURES, LatentConfig(**values), width=WIDTH)


def geometry(samples: BoxSamples, radius: float = RADIUS) -> Neighbourhoods:
    net = encoder()
    return neighbourhoods(
        samples.points[0, 0], samples.valid[0, 0], places=net.places, kernel=net.kernel, radius=radius
    )


def joined(*samples: BoxSamples, along: Literal["batch", "sample"] = "batch") -> BoxSamples:
    names = [field.name for field in dataclasses.fields(BoxSamples)]
    axis = {"batch": 0, "sample": 3}[along]
    return BoxSamples(**{name: torch.cat([getattr(one, name) for one in samples], dim=axis) for name in names})


def padded(samples: BoxSamples, count: int, value: float) -> BoxSamples:
    """With `count` samples more that are not there, wherever they are said to be."""
    more = [(0, 0, 0, count), (0, 0, 0, count), (0, count), (0, count)]
    parts = [samples.points, samples.features, samples.mask, samples.valid]
    points, features, mask, valid = (
        torch.nn.functional.pad(part, width, value=0 if part.dtype == torch.bool else value)
        for part, width in zip(parts, more, strict=True)
    )
    return BoxSamples(points, features * valid[..., None], mask * valid, valid)


def weighted(influences: torch.Tensor) -> torch.Tensor:
    """How many neighbours have a positive influence, "... neighbour kernel" to "..."."""
    return (influences > 0).any(dim=-1).sum(dim=-1).float()


@pytest.mark.parametrize(
    ("spacing", "around", "expected"),
    [(SPARSE, NOTHING, 4), (SPARSE, table(SPARSE), 6), (DENSE, NOTHING, 12), (DENSE, table(DENSE), 12)],
    ids=["sparse", "sparse-on-table", "dense", "dense-on-table"],
)
def test_neighbourhoods_hold_neighbours(spacing: float, around: torch.Tensor, expected: int):
    near = geometry(crop(half_a_cube(spacing), around))
    assert weighted(near.influences).median() >= expected
    assert weighted(near.influences).min() >= 3
    assert weighted(near.central).min() == len(encoder().places)
    used = (near.influences > 0).any(dim=2).sum(dim=-1).float()
    assert used.mean() > 5, "Neighbours should reach several kernel points."


def test_neighbours_are_the_nearest_samples_and_those_in_reach_share_the_influence():
    net, samples = encoder(), crop(half_a_cube(SPARSE), table(SPARSE), samples=50)
    assert samples.valid.all()
    near, points = geometry(samples), samples.points[0, 0, 0]
    anchors = points[torch.cdist(net.places, points).argmin(dim=-1)]
    nearest = torch.cdist(anchors, points).topk(NEIGHBOURS, largest=False)
    assert torch.equal(near.index[0].sort().values, nearest.indices.sort().values)
    assert len(anchors.unique(dim=0)) > 8, "Anchors should spread over the box."
    in_reach = (nearest.values < RADIUS).sum(dim=-1)
    assert 3 <= in_reach.min() < NEIGHBOURS
    offsets = (points[near.index[0]] - anchors[:, None]) / RADIUS
    distances = (offsets[:, :, None] - net.kernel).norm(dim=-1)
    expected = (1 - distances / EXTENT).clamp(min=0) * (offsets.norm(dim=-1) < 1)[..., None]
    torch.testing.assert_close(near.influences[0], expected / in_reach[:, None, None], atol=1e-5, rtol=0)


def test_in_a_small_radius_every_anchor_is_alone():
    near = geometry(crop(half_a_cube(SPARSE), table(SPARSE)), radius=0.025)
    assert ((near.influences > 0).any(dim=-1).sum(dim=-1) == 1).all()
    torch.testing.assert_close(near.influences.sum(dim=(2, 3)), torch.ones(near.index.shape[:2]), atol=1e-4, rtol=0)


def test_positions_sines_and_mean_features_can_be_left_out():
    samples = crop(half_a_cube(SPARSE), table(SPARSE))
    whole, plain = encoder(), encoder(frequencies=0, means="none")
    assert plain(samples).shape[-1] == plain.size == whole.size - FEATURES == WIDTH
    assert whole.get_parameter("_points.0.weight").shape[1] - plain.get_parameter("_points.0.weight").shape[1] == 18
    mean = samples.features.sum(dim=3) / samples.mask.sum(dim=3)[..., None]
    torch.testing.assert_close(whole(samples)[..., WIDTH:], mean)


@pytest.mark.parametrize("value", [0.0, 0.3])
def test_samples_that_are_not_there_do_not_matter(value: float):
    samples = crop(half_a_cube(DENSE), NOTHING)
    assert samples.valid.all()
    torch.testing.assert_close(encoder()(padded(samples, 50, value)), encoder()(samples), atol=1e-5, rtol=0)


def test_turning_the_cloud_and_its_box_together_changes_nothing():
    axis = torch.randn(3, 3, generator=torch.Generator().manual_seed(4))
    turn = torch.linalg.matrix_exp(axis - axis.T)
    cube, around = half_a_cube(SPARSE), table(SPARSE)
    still, turned = crop(cube, around), crop(cube @ turn.T, around @ turn.T, rotation=turn)
    codes = encoder()(still), encoder()(turned)
    torch.testing.assert_close(*codes, atol=1e-4, rtol=0)
    unturned_box = crop(cube @ turn.T, around @ turn.T)
    assert (encoder()(unturned_box) - codes[0]).abs().max() > 1e-3


def test_samples_that_are_there_twice_count_once():
    samples = crop(half_a_cube(SPARSE)[:6], NOTHING)
    torch.testing.assert_close(encoder()(joined(samples, samples, along="sample")), encoder()(samples))


def test_every_weight_and_feature_is_used():
    net, samples = encoder(), crop(half_a_cube(SPARSE), table(SPARSE))
    samples.features.requires_grad_()
    net(samples).square().sum().backward()
    for name, parameter in net.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name
    assert samples.features.grad is not None
    assert (samples.features.grad.abs().sum(dim=-1)[samples.valid] > 0).all()
    inputs = net.get_parameter("_points.0.weight").grad
    assert inputs is not None
    assert (inputs.abs().sum(dim=0) > 0).all(), "An input is not used."


def test_a_box_without_points_has_a_finite_code_and_finite_gradients():
    net, samples = encoder(), crop(half_a_cube(SPARSE), NOTHING)
    empty = BoxSamples(0 * samples.points, 0 * samples.features, 0 * samples.mask, torch.zeros_like(samples.valid))
    empty.features.requires_grad_()
    code = net(empty)
    code.square().sum().backward()
    assert code.isfinite().all()
    assert empty.features.grad is not None
    assert (empty.features.grad == 0).all()
    assert all(parameter.grad is None or parameter.grad.isfinite().all() for parameter in net.parameters())
    torch.testing.assert_close(net(joined(empty, samples))[0], code[0])
    elsewhere = dataclasses.replace(empty, points=empty.points + 0.3)
    torch.testing.assert_close(net(elsewhere), code)
