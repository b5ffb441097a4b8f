"""Patterns on the table, as values: what is added to the logits of the background's colours.

A pattern is a square of points, x and y of the world, the outermost on the edges of the workspace; beyond an edge it is
as at the edge. Away from z = 0 there is none.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from obpose.model.obpose import ObPose

EDGE = 128
"""Points along each edge."""
NEAR = 0.03
"""What is farther from z = 0 is not the table, metres."""

SPOT = 64
"""Points along each edge of a spot."""

_WIDE = 17
"""Points over which what changes slowly is taken out of a spot: the light of a lamp, and how objects dim the table."""
_MOST = 3.0
"""What differs more from the median than so many times as the median of such differences sticks out."""

Pattern = Float[Tensor, "x y 3"]
Spot = Float[Tensor, "spot spot 3"]


def no_pattern(like: Tensor | None = None) -> Pattern:
    """None; of the same kind of numbers as `like`."""
    return torch.zeros(EDGE, EDGE, 3) if like is None else like.new_zeros(EDGE, EDGE, 3)


def pattern_at(model: ObPose, pattern: Pattern, points: Float[Tensor, "point 3"]) -> Float[Tensor, "point 3"]:
    """Its values at points of the world, metres: bilinear."""
    places, _ = on_pattern(model, points)
    # grid_sample has the last axis first.
    at = places.flip(-1)[None, None]
    values = F.grid_sample(pattern.permute(2, 0, 1)[None], at, align_corners=True, padding_mode="border")
    return values[0, :, 0].T * _on_table(points)[:, None]


def on_pattern(
    model: ObPose, points: Float[Tensor, "point 3"]
) -> tuple[Float[Tensor, "point 2"], Bool[Tensor, "point"]]:
    """Where on the square, -1..1, points of the world are, metres, and whether they are on it."""
    places = (points[:, :2] - model.center[:2]) * (2 / model.config.model.workspace_size)
    return places, (places.abs() <= 1).all(dim=-1) & _on_table(points)


def _on_table(points: Float[Tensor, "point 3"]) -> Bool[Tensor, "point"]:
    return points[:, 2].abs() <= NEAR


def spot_of(pattern: Pattern) -> Spot:
    """The middle of it, which cameras see: what patterns like it are made of."""
    return pattern[EDGE // 4 : EDGE // 4 + SPOT, EDGE // 4 : EDGE // 4 + SPOT]


def pattern_like(spot: Spot, generator: torch.Generator) -> Pattern:
    """A Gaussian texture with the spot's autocorrelation (Galerne, Gousseau and Morel 2011), around no pattern.

    Such are wood, cloth and stains; of checks only the directions and the scale stay. What sticks out of the spot, such
    as the rest of a shadow, is cut off.
    """
    planes = _usual(spot.permute(2, 0, 1))
    around = _usual(planes - F.avg_pool2d(planes, _WIDE, stride=1, padding=_WIDE // 2, count_include_pad=False))
    fade = torch.outer(*2 * [torch.hann_window(SPOT, periodic=False).sqrt()])
    spots = (around - around.mean(dim=(1, 2), keepdim=True)) * fade / fade.square().mean().sqrt() / SPOT
    size = (EDGE + SPOT, EDGE + SPOT)
    noise = torch.fft.rfft2(torch.randn(size, generator=generator))
    drawn = torch.fft.irfft2(noise * torch.fft.rfft2(spots, s=size), s=size)
    # What is left out wraps around.
    return drawn[:, SPOT:, SPOT:].permute(1, 2, 0).contiguous()


def _usual(planes: Float[Tensor, "colour x y"]) -> Float[Tensor, "colour x y"]:
    """Without what sticks out."""
    middle = planes.flatten(1).median(dim=1).values[:, None, None]
    most = _MOST * (planes - middle).abs().flatten(1).median(dim=1).values[:, None, None]
    return planes.clamp(middle - most, middle + most)
