import math

import pytest
import torch
from torch.distributions import Normal

from obpose.baselines.obsurf import losses
from obpose.baselines.obsurf.config import ObsurfLossConfig
from obpose.model.nerf.along import air_points
from obpose.types import Rays

SLOTS, RAYS = 3, 7
EVERY = torch.ones(1, 1, RAYS)


def logits() -> torch.Tensor:
    return 3 * torch.randn(1, 1, SLOTS, RAYS, generator=torch.Generator().manual_seed(0))


def test_densities_of_slots_add_up_and_each_is_below_its_largest():
    summed = 10 * torch.sigmoid(logits()).sum(dim=2)
    torch.testing.assert_close(losses.log_density(logits()).exp(), summed)
    full = torch.full((1, 1, SLOTS, RAYS), 50.0)
    torch.testing.assert_close(losses.log_density(full).exp(), torch.full((1, 1, RAYS), 10.0 * SLOTS))


def test_shares_are_those_of_densities():
    densities = torch.sigmoid(logits())
    torch.testing.assert_close(losses.log_share(logits()).exp(), densities / densities.sum(dim=2, keepdim=True))


def test_far_logits_keep_a_gradient_at_the_surface():
    low = torch.full((1, 1, SLOTS, RAYS), -200.0, requires_grad=True)
    loss = losses.surface(low, EVERY)
    assert loss.item() == pytest.approx(200 - math.log(10 * SLOTS), rel=1e-4)
    loss.backward()
    assert low.grad is not None
    torch.testing.assert_close(low.grad.sum(), torch.tensor(-1.0))


def test_colour_is_one_gaussian_around_the_mean_of_the_slots():
    generator = torch.Generator().manual_seed(4)
    colours, target = (torch.rand(shape, generator=generator) for shape in ((1, 1, SLOTS, RAYS, 3), (1, 1, RAYS, 3)))
    densities = torch.sigmoid(logits())
    mean = (densities / densities.sum(dim=2, keepdim=True))[..., None].mul(colours).sum(dim=2)
    expected = -Normal(mean, 0.2).log_prob(target).sum(dim=-1).mean()
    found = losses.colour(losses.mean_colour(logits(), colours), target, EVERY, std=0.2)
    assert found.item() == pytest.approx(expected.item(), rel=1e-5)


def test_nothing_overlaps_where_one_slot_explains_it_all():
    alone = torch.full((1, 1, SLOTS, RAYS), -60.0)
    alone[:, :, 1] = 20.0
    assert losses.overlap(alone, EVERY).item() == pytest.approx(0, abs=1e-5)
    shared = torch.zeros(1, 1, SLOTS, RAYS)
    assert losses.overlap(shared, EVERY).item() == pytest.approx(10.0)


@pytest.mark.parametrize(("fraction", "weight"), [(0.0, 0.0), (0.2, 0.0), (0.3, 0.025), (0.4, 0.05), (1.0, 0.05)])
def test_the_overlap_grows_in_a_part_of_the_budget(fraction: float, weight: float):
    config = ObsurfLossConfig(overlap=0.05, overlap_start=0.2, overlap_full=0.4)
    assert losses.overlap_weight(config, fraction) == pytest.approx(weight)


def test_the_air_term_estimates_the_integral_of_the_density():
    """Along a ray that is not of unit length, in units of which a metre has several."""
    units_per_metre, depth, rays = 8.0, 1.2, 200_000
    direction = torch.tensor([0.6, 0.0, 1.0]).expand(1, 1, rays, 3)
    seen = torch.ones(1, 1, rays)
    ray = Rays(seen.long(), seen.bool(), seen, direction * 0, direction * 0, direction, depth * seen)
    points, inverse_rho = air_points(ray, 0.98, torch.Generator().manual_seed(0))
    units = points.norm(dim=-1) * units_per_metre
    length = inverse_rho * units_per_metre * math.sqrt(1.36)
    found = losses.air((0.3 * units - 3)[:, :, None], length, seen)
    end = depth * units_per_metre * math.sqrt(1.36)
    softplus = lambda x: math.log1p(math.exp(x))  # noqa: E731
    assert found.item() == pytest.approx(10 * (softplus(0.3 * end - 3) - softplus(-3)) / 0.3, rel=0.01)


def test_rays_without_weight_do_not_count():
    some = EVERY.clone()
    some[..., 3:] = 0
    spoiled = logits()
    spoiled[..., 3:] = torch.nan
    for term in (losses.surface, losses.overlap):
        whole = term(logits()[..., :3], EVERY[..., :3])
        assert term(spoiled, some).item() == pytest.approx(whole.item(), rel=1e-5)
