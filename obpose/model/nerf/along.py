"""The fields along rays: what of them the losses compare with what was observed (paper, L_obs)."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.config import LossConfig
from obpose.model.nerf.components import Colours
from obpose.model.nerf.points import air_points, surface_points
from obpose.types import Decoded, Rays


@runtime_checkable
class Decode(Protocol):
    """Densities, and colours if asked for, at world points."""

    def __call__(
        self,
        points: Float[Tensor, "batch frame ray 3"],
        directions: Float[Tensor, "batch frame ray 3"],
        colours: Colours,
    ) -> Decoded:
        """Of all components, or of some."""
        ...


@dataclass(frozen=True, eq=False)
class FieldsAlongRays:
    """One point at the surface of each ray, and one before it."""

    rays: Rays
    surface: Decoded
    """With colours."""
    air: Decoded
    inverse_rho: Float[Tensor, "batch frame ray"]
    """Of the points in the air, metres."""


def fields_along(rays: Rays, decode: Decode, loss: LossConfig, generator: torch.Generator | None) -> FieldsAlongRays:
    """Evaluate the fields at a random place near the surface and at one in the air."""
    surface = surface_points(rays, loss.jitter, generator)
    air, inverse_rho = air_points(rays, loss.near_share, generator)
    return FieldsAlongRays(
        rays=rays,
        surface=decode(surface, rays.direction, "with"),
        air=decode(air, rays.direction, "without"),
        inverse_rho=inverse_rho,
    )
