"""Points along rays: at the observed surface and in the air before it (paper, L_obs)."""

import torch
from torch import Tensor

from obpose.types import RayPoints, Rays, RayValues


def surface_points(rays: Rays, jitter: float, generator: torch.Generator | None) -> RayPoints:
    """Draw points uniformly up to `jitter` metres of planar depth behind the observed surface."""
    if jitter == 0:
        return _at_depth(rays, rays.depth)
    return _at_depth(rays, rays.depth + jitter * _uniform(rays, generator))


def air_points(rays: Rays, near_share: float, generator: torch.Generator | None) -> tuple[RayPoints, RayValues]:
    """Draw a point before the surface of each ray; also give 1 / rho_air, in metres of planar depth.

    With equal probability, it lies uniformly in the first `near_share` of the depth or in the rest, next to the
    surface. The mean of f / rho is the integral of f over the planar depth from the camera to the surface.
    """
    within = _uniform(rays, generator)
    far = _uniform(rays, generator) < 0.5
    share = torch.where(far, near_share * within, near_share + (1 - near_share) * within)
    length = torch.where(far, near_share, 1 - near_share)
    return _at_depth(rays, rays.depth * share), 2 * length * rays.depth


def _at_depth(rays: Rays, depth: Tensor) -> Tensor:
    return rays.origin + rays.direction * depth[..., None]


def _uniform(rays: Rays, generator: torch.Generator | None) -> Tensor:
    return torch.rand(rays.depth.shape, generator=generator, dtype=rays.depth.dtype, device=rays.depth.device)
