"""What is asked of the fields along rays."""

import torch

from obpose.model.nerf.along import JITTER, fields_along
from obpose.model.nerf.components import Colours
from obpose.types import Decoded
from tests.obpose.model.nerf.test_points import generator, rays_of_depth


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


def test_the_generator_decides():
    rays = rays_of_depth(torch.ones(1, 1, 20))
    first, again, other = (fields_along(rays, height_as_density, generator(seed)) for seed in (3, 3, 4))
    assert torch.equal(first.surface.logits, again.surface.logits)
    assert torch.equal(first.air.logits, again.air.logits)
    assert not torch.equal(first.air.logits, other.air.logits)
