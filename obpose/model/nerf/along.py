"""Fields along rays, which the losses compare with the observation (paper, L_obs)."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch

from obpose.model.nerf.components import Colours
from obpose.model.nerf.points import air_points, surface_points
from obpose.types import Decoded, RayPoints, Rays, RayValues

JITTER = 0.01
"""Distance behind the surface up to which colour and density are fitted, metres of planar depth. [code]"""
NEAR_SHARE = 0.98
"""Share of the depth that splits the air points: half of them lie before it, half behind. [code]"""


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
