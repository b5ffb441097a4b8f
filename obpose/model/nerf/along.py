"""Fields along rays, which the losses compare with the observation (paper, eq. 9)."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from obpose.model.nerf.components import Colours
from obpose.types import Decoded, RayPoints, Rays, RayValues

JITTER = 0.01
"""Distance behind the surface up to which colour and density are fitted, metres of planar depth. [code]"""
NEAR_SHARE = 0.98
"""Share of the depth that splits the air points: half of them lie before it, half behind. [code]"""


def surface_points(rays: Rays, jitter: float, generator: torch.Generator | None) -> RayPoints:
    """Draw points uniformly up to `jitter` metres of planar depth behind the observed surface."""
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


@runtime_checkable
class Decode(Protocol):
    """Function from world points to densities, and colours if requested."""

    def __call__(self, points: RayPoints, directions: RayPoints, colours: Colours) -> Decoded:
        """Evaluate all components, or some."""
        ...


@dataclass(frozen=True, eq=False)
class FieldsAlongRays:
    """Fields at one point at the surface of each ray, and at one before it."""

    rays: Rays
    surface: Decoded
    """Densities and colours."""
    air: Decoded
    inverse_rho: RayValues
    """1 / rho_air at the points in the air, metres."""


def fields_along(rays: Rays, decode: Decode, generator: torch.Generator | None) -> FieldsAlongRays:
    """Evaluate the fields at a random point near the surface of each ray and at one in the air."""
    surface = surface_points(rays, JITTER, generator)
    air, inverse_rho = air_points(rays, NEAR_SHARE, generator)
    return FieldsAlongRays(
        rays=rays,
        surface=decode(surface, rays.direction, "with"),
        air=decode(air, rays.direction, "without"),
        inverse_rho=inverse_rho,
    )
