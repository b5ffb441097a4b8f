import math

import pytest
import torch

from obpose.model.nerf.render import render
from obpose.types import Decoded

NEAR, FAR = 0.5, 1.5


def ray() -> tuple[torch.Tensor, torch.Tensor]:
    """One along z, not through the origin, seen at a slant: a metre of planar depth is longer than a metre."""
    return torch.tensor([0.3, 0.1, 0.0]).view(1, 1, 1, 3), torch.tensor([0.5, 0.0, 1.0]).view(1, 1, 1, 3)


def slab(logits: tuple[float, ...], start: float, end: float):
    """Components with these logits from one depth to another, in grey, the first black, the last white."""

    def decode(points: torch.Tensor, directions: torch.Tensor) -> Decoded:
        inside = (points[..., 2] > start) & (points[..., 2] < end)
        values = torch.where(inside[:, :, None], torch.tensor(logits)[:, None], -20.0)
        grey = torch.linspace(0, 1, len(logits))[:, None, None]
        return Decoded(values, grey.expand(1, 1, *values.shape[2:], 3))

    return decode


def test_a_slab_takes_light_away_as_beer_and_lambert_say():
    rendering = render(slab((0.0,), 0.8, 1.0), *ray(), near=NEAR, far=FAR, samples=1000, sigma_max=10.0)
    sigma = 10 * math.tanh(math.log(2))
    assert rendering.weights.item() == pytest.approx(1 - math.exp(-0.2 * sigma), abs=1e-4)


def test_the_depth_is_the_mean_of_where_light_comes_from():
    dense = render(slab((9.0,), 0.8, FAR), *ray(), near=NEAR, far=FAR, samples=4000, sigma_max=100.0)
    assert dense.depth.item() == pytest.approx(0.8 + 1 / 100, abs=1e-3)
    empty = render(slab((-20.0,), 0.8, FAR), *ray(), near=NEAR, far=FAR, samples=100, sigma_max=10.0)
    assert empty.depth.item() == pytest.approx(FAR, abs=1e-4)


def test_components_share_light_and_colour_as_they_share_density():
    rendering = render(slab((1.0, 3.0), 0.8, FAR), *ray(), near=NEAR, far=FAR, samples=200, sigma_max=1000.0)
    share = 1 / (1 + math.exp(-2))
    torch.testing.assert_close(rendering.weights[0, 0, :, 0], torch.tensor([1 - share, share]), atol=1e-4, rtol=0)
    torch.testing.assert_close(rendering.colour[0, 0, 0], torch.full((3,), share), atol=1e-4, rtol=0)


def test_more_samples_change_nothing():
    few, many = (
        render(slab((0.0, -1.0), 0.75, 1.0), *ray(), near=NEAR, far=FAR, samples=n, sigma_max=10.0) for n in (40, 400)
    )
    torch.testing.assert_close(few.weights, many.weights, atol=1e-4, rtol=0)


def test_what_lies_behind_an_opaque_thing_is_not_seen():
    def decode(points: torch.Tensor, directions: torch.Tensor) -> Decoded:
        behind = points[..., 2] > 1
        logits = torch.stack([torch.where(behind, -20.0, 9.0), torch.where(behind, 9.0, -20.0)], dim=2)
        return Decoded(logits, torch.zeros(*logits.shape, 3))

    rendering = render(decode, *ray(), near=NEAR, far=FAR, samples=100, sigma_max=1000.0)
    torch.testing.assert_close(rendering.weights[0, 0, :, 0], torch.tensor([1.0, 0.0]), atol=1e-4, rtol=0)


def test_rendering_without_colours_is_refused():
    def decode(points: torch.Tensor, directions: torch.Tensor) -> Decoded:
        return Decoded(torch.zeros(*points.shape[:2], 1, points.shape[2]), None)

    with pytest.raises(ValueError, match="needs colours"):
        render(decode, *ray(), near=NEAR, far=FAR, samples=10, sigma_max=10.0)
