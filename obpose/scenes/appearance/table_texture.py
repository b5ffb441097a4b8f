"""Textures of the table: values that are added to the logits of the background's colours.

A texture is a square of points along the world's x and y, the outermost on the edges of the workspace. Beyond the edges
it is extended by its border values. Surfaces away from z = 0 have no texture.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from obpose.model.obpose import ObPose

Points = Float[Tensor, "point 3"]

EDGE = 128
"""Points along each edge."""
NEAR = 0.03
"""Largest distance of the table's surface from z = 0, metres."""

PATCH = 64
"""Points along each edge of a patch of texture."""

_WIDE = 17
"""Width in points of the high-pass filter of patches, which removes the glow of lamps and ambient occlusion."""
_MOST = 3.0
"""Limit of outliers, in median absolute deviations from the median."""

Texture = Float[Tensor, "x y 3"]
Patch = Float[Tensor, "patch patch 3"]


def no_texture(like: Tensor | None = None) -> Texture:
    """Give the absence of a texture, in the type of `like`."""
    return torch.zeros(EDGE, EDGE, 3) if like is None else like.new_zeros(EDGE, EDGE, 3)


def texture_at(model: ObPose, texture: Texture, points: Points) -> Points:
    """Interpolate a texture at points of the world, metres (bilinear)."""
    places, _ = on_texture(model, points)
    # grid_sample has the last axis first.
    at = places.flip(-1)[None, None]
    values = F.grid_sample(texture.permute(2, 0, 1)[None], at, align_corners=True, padding_mode="border")
    return values[0, :, 0].T * _on_table(points)[:, None]


def on_texture(model: ObPose, points: Points) -> tuple[Float[Tensor, "point 2"], Bool[Tensor, "point"]]:
    """Give positions on the square, -1..1, of points of the world, metres, and whether they are on it."""
    places = (points[:, :2] - model.center[:2]) * (2 / model.config.model.workspace_size)
    return places, (places.abs() <= 1).all(dim=-1) & _on_table(points)


def _on_table(points: Points) -> Bool[Tensor, "point"]:
    return points[:, 2].abs() <= NEAR


def patch_of(texture: Texture) -> Patch:
    """Cut out the middle of a texture, which cameras see."""
    return texture[EDGE // 4 : EDGE // 4 + PATCH, EDGE // 4 : EDGE // 4 + PATCH]


def texture_like(patch: Patch, generator: torch.Generator) -> Texture:
    """Draw a Gaussian texture of mean 0 with the patch's autocorrelation (Galerne, Gousseau and Morel 2011).

    It suits wood, cloth and stains; checks keep only their directions and scale. Outliers, such as the remains of a
    shadow, are clamped.
    """
    planes = _usual(patch.permute(2, 0, 1))
    around = _usual(planes - F.avg_pool2d(planes, _WIDE, stride=1, padding=_WIDE // 2, count_include_pad=False))
    fade = torch.outer(*2 * [torch.hann_window(PATCH, periodic=False).sqrt()])
    patches = (around - around.mean(dim=(1, 2), keepdim=True)) * fade / fade.square().mean().sqrt() / PATCH
    size = (EDGE + PATCH, EDGE + PATCH)
    noise = torch.fft.rfft2(torch.randn(size, generator=generator))
    drawn = torch.fft.irfft2(noise * torch.fft.rfft2(patches, s=size), s=size)
    # The part that is cut off wraps around.
    return drawn[:, PATCH:, PATCH:].permute(1, 2, 0).contiguous()


def _usual(planes: Float[Tensor, "colour x y"]) -> Float[Tensor, "colour x y"]:
    """Clamp outliers."""
    middle = planes.flatten(1).median(dim=1).values[:, None, None]
    most = _MOST * (planes - middle).abs().flatten(1).median(dim=1).values[:, None, None]
    return planes.clamp(middle - most, middle + most)
