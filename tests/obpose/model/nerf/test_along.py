"""Points along rays at which fields are evaluated."""

import math

import pytest
import torch

from obpose.model.nerf.along import JITTER, air_points, fields_along, surface_points
from obpose.model.nerf.components import Colours
from obpose.types import Decoded, Rays


def height_as_density(points: torch.Tensor, directions: torch.Tensor, colours: Colours) -> Decoded:
    """One component whose density logit is z, with the direction for its colour."""
    return Decoded(points[..., None, :, 2], directions[:, :, None] if colours == "with" else None)


def test_fields_are_read_at_the_surface_with_colours_and_in_the_air_without():
    rays = rays_of_depth(torch.rand(2, 3, 500, generator=generator(1)) + 0.5)
    along = fields_along(rays, height_as_density, generator())
    surface, air = along.surface.logits[:, :, 0], along.air.logits[:, :, 0]
    assert ((surface >= rays.depth - 1e-6) & (surface <= rays.depth + JITTER + 1e-6)).all()
    assert ((air > 0) & (air < rays.depth)).all()
    assert along.surface.colours is not None
    assert torch.equal(along.surface.colours[:, :, 0], rays.direction)
    assert along.air.colours is None
    assert along.rays is rays


def test_the_weights_are_those_of_the_points_in_the_air():
    depth = 1.5
    rays = rays_of_depth(torch.full((1, 4, 50_000), depth))
    along = fields_along(rays, height_as_density, generator())
    estimates = along.air.logits[:, :, 0] * along.inverse_rho
    error = 4 * estimates.std() / estimates.numel() ** 0.5
    assert abs(estimates.mean() - depth**2 / 2) < error < 0.02


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
