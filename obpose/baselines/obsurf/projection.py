"""Fourier code of positions, and projection of world points into the input image."""

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.model.layers.numerics import full_precision

FIRST_OCTAVE = -5
"""Smallest k of the Fourier code. [code]"""
_NEAREST = 1e-3
"""Smallest depth of points in the image, metres."""


def fourier_code(points: Float[Tensor, "*shape 3"], *, last: int) -> Float[Tensor, "*shape code"]:
    """Points p, and sin and cos of 2^k pi p for k from `FIRST_OCTAVE` to `last`."""
    scales = math.pi * 2.0 ** torch.arange(FIRST_OCTAVE, last + 1, dtype=points.dtype, device=points.device)
    angles = (points[..., None] * scales).flatten(start_dim=-2)
    return torch.cat([points, angles.sin(), angles.cos()], dim=-1)


def code_size(*, last: int) -> int:
    """Number of channels of `fourier_code`."""
    return 3 + 6 * (last + 1 - FIRST_OCTAVE)


@full_precision
def project(
    points: Float[Tensor, "image point 3"], k: Float[Tensor, "image 3 3"], world_from_camera: Float[Tensor, "image 4 4"]
) -> tuple[Float[Tensor, "image point 2"], Bool[Tensor, "image point"]]:
    """Pixel coordinates (u, v) of world points in each image, centres at +0.5, and whether they are before the camera.

    Deviation: the published code assumes a camera that looks at the origin, and one set of intrinsics.
    """
    in_camera = (points - world_from_camera[:, None, :3, 3]) @ world_from_camera[:, :3, :3]
    before = in_camera[..., 2] > _NEAREST
    on_plane = in_camera / in_camera[..., 2:].clamp(min=_NEAREST)
    return (on_plane @ k.mT)[..., :2], before


def nearest_cells(
    pixels: Float[Tensor, "image point 2"], *, size: tuple[int, int], grid: tuple[int, int]
) -> Int[Tensor, "image point"]:
    """Indices of the cells of a feature grid that contain pixels; beyond the border, of the nearest cell.

    `size` and `grid` are heights and widths, of the image and of the grid that covers it.
    """
    (height, width), (rows, columns) = size, grid
    column = (pixels[..., 0] * (columns / width)).floor().clamp(0, columns - 1).long()
    row = (pixels[..., 1] * (rows / height)).floor().clamp(0, rows - 1).long()
    return row * columns + column
