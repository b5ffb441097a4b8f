"""Volume rendering of the composed scene, slow and exact: the reference that tests compare faster rendering with."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from einops import rearrange, repeat
from jaxtyping import Float
from torch import Tensor

from obpose.model.nerf.compose import solid_share
from obpose.types import ComponentRays, Decoded, RayPoints, RayValues


@dataclass(frozen=True, eq=False)
class Rendering:
    """Rendered image, ray by ray."""

    colour: RayPoints
    """0..1, on a black background."""
    depth: RayValues
    """Mean planar depth of the light's origin; `far` for light from beyond."""
    weights: ComponentRays
    """Share of the light that comes from each component; together the opacity."""


def render(
    decode: Callable[[RayPoints, RayPoints], Decoded],
    origin: RayPoints,
    direction: RayPoints,
    *,
    near: float,
    far: float,
    samples: int,
    sigma_max: float,
    threshold: float = 0.0,
) -> Rendering:
    """Quadrature along rays (Mildenhall et al. 2020, eq. 3) of the composed density (paper, eq. 8).

    `direction` is per metre of planar depth. There are `samples` points along a ray, in the middles of equal intervals
    from planar depth `near` to `far`, metres. `sigma_max` is the density of an opaque point per metre of planar depth.
    With the loss's 10, objects of a few centimetres are half transparent; pictures are sharp with some hundreds. Space
    is empty below the density `threshold` over sigma_max (`obpose.model.nerf.compose.solid_share`).
    """
    # Points along the rays.
    edges = torch.linspace(near, far, samples + 1, dtype=origin.dtype, device=origin.device)
    depths = (edges[:-1] + edges[1:]) / 2
    along = repeat(direction, "b f r xyz -> b f (r sample) xyz", sample=samples)
    points = origin[..., None, :] + direction[..., None, :] * depths[:, None]
    points = rearrange(points, "b f r sample xyz -> b f (r sample) xyz")
    # Densities and colours (paper, eq. 8).
    decoded = decode(points, along)
    if decoded.colours is None:
        raise ValueError("Rendering needs colours, but `decode` gave none; let it decode with colours.")
    shares = rearrange(solid_share(decoded.logits, threshold), "b f c (r sample) -> b f c r sample", sample=samples)
    colours = rearrange(decoded.colours, "b f c (r sample) rgb -> b f c r sample rgb", sample=samples)
    # Quadrature (Mildenhall et al. 2020, eq. 3).
    weights = light_from(sigma_max * (far - near) / samples * shares)
    through = 1 - weights.sum(dim=(2, 4))
    return Rendering(
        colour=(weights[..., None] * colours).sum(dim=(2, 4)),
        depth=(weights.sum(dim=2) * depths).sum(dim=-1) + through * far,
        weights=weights.sum(dim=-1),
    )


def light_from(thickness: Float[Tensor, "*batch component ray sample"]) -> Float[Tensor, "*batch component ray sample"]:
    """Share of a ray's light from each sample and component, given their optical thickness."""
    total = thickness.sum(dim=-3)
    transmitted = torch.exp(total - total.cumsum(dim=-1))
    # Light that a sample stops, divided among the components by density.
    stopped = -torch.expm1(-total) * transmitted
    return (stopped / total.clamp(min=1e-12))[..., None, :, :] * thickness
