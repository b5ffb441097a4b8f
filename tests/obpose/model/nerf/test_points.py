import math

import pytest
import torch

from obpose.model.nerf.points import air_points, surface_points
from obpose.types import Rays


def rays_of_depth(depth: torch.Tensor) -> Rays:
    """Side by side along a direction that is not of unit length, one metre of planar depth to one of z."""
    ones = torch.ones(*depth.shape, 3)
    direction = torch.tensor([0.5, -0.2, 1.0]).expand_as(ones)
    seen = depth > 0
    return Rays(torch.zeros(depth.shape, dtype=torch.long), seen, seen.float(), ones, 0 * ones, direction, depth)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("near_share", [0.5, 0.98])
def test_air_weights_give_the_integral_over_the_planar_depth(near_share: float):
    depth = 1.2
    points, inverse_rho = air_points(rays_of_depth(torch.full((1, 4, 100_000), depth)), near_share, generator())
    density = torch.exp(-30 * (points[..., 2] - depth).square()) + 0.1 * points[..., 2]
    blob = math.sqrt(math.pi / 30) / 2 * math.erf(math.sqrt(30) * depth)
    estimates = density * inverse_rho
    error = 4 * estimates.std() / math.sqrt(estimates.numel())
    assert abs(estimates.mean() - (blob + 0.05 * depth**2)) < error < 0.02


def test_half_of_the_air_points_are_next_to_the_surface():
    depth = torch.rand(2, 3, 5000, generator=generator(1)) + 0.5
    points, inverse_rho = air_points(rays_of_depth(depth), 0.98, generator())
    share = points[..., 2] / depth
    assert ((share > 0) & (share < 1)).all()
    near = share > 0.98
    assert abs(near.float().mean() - 0.5) < 0.02
    torch.testing.assert_close(inverse_rho, 2 * depth * torch.where(near, 0.02, 0.98))


def test_surface_points_lie_up_to_the_jitter_behind_the_surface():
    depth = torch.rand(2, 3, 500, generator=generator(1)) + 0.5
    rays = rays_of_depth(depth)
    behind = surface_points(rays, 0.01, generator())[..., 2] - depth
    assert behind.min() >= -1e-6
    assert 0.009 < behind.max() <= 0.01 + 1e-6
    torch.testing.assert_close(surface_points(rays, 0.0, None), rays.direction * depth[..., None])


def test_points_are_on_the_rays():
    rays = rays_of_depth(torch.rand(2, 3, 50, generator=generator(1)) + 0.5)
    for points in (surface_points(rays, 0.01, generator()), air_points(rays, 0.98, generator())[0]):
        torch.testing.assert_close(points, rays.direction * points[..., 2:])


def test_the_generator_decides():
    rays = rays_of_depth(torch.ones(1, 1, 20))
    first, second = (air_points(rays, 0.98, generator(3))[0] for _ in range(2))
    assert first.equal(second)
    assert not first.equal(air_points(rays, 0.98, generator(4))[0])
