"""Masks of the embedding grid at pixels of the image (paper, section Training: the masks meet the decoder there)."""

import math

import torch
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample

_SMALLEST = -80.0
"""Log masks are not below this: e^-80 is about the smallest probability in single precision."""

_INVALID = 1e-20
"""Weight of a cell without a point: none, unless its neighbours have none either."""


def masks_at(
    log_masks: Float[Tensor, "batch frame component point"],
    valid: Bool[Tensor, "batch frame point"],
    index: Int[Tensor, "batch frame ray"],
    *,
    grid: tuple[int, int, int],
    size: tuple[int, int],
) -> Float[Tensor, "batch frame component ray"]:
    """Log of the masks at the pixels `index`, counted through all views, by bilinear interpolation of the masks.

    `grid` is (view, height, width) of the points, `size` (height, width) of the image. Cells that are not valid are
    left out, the weights of the others made to sum to one; so the masks and the scope still do. Deviation: the
    authors' code interpolates between the three points nearest in space, which needs a search.
    """
    masks, present = log_masks.exp(), valid[:, :, None].to(log_masks.dtype).clamp(min=_INVALID)
    summed = _interpolate(torch.cat([masks * present, present], dim=2), index, grid=grid, size=size)
    mixed = summed[:, :, :-1] / summed[:, :, -1:]
    return mixed.clamp(min=math.exp(_SMALLEST)).log()


def _interpolate(
    values: Float[Tensor, "batch frame channel point"],
    index: Int[Tensor, "batch frame ray"],
    *,
    grid: tuple[int, int, int],
    size: tuple[int, int],
) -> Float[Tensor, "batch frame channel ray"]:
    (height, width), (views, rows, columns) = size, grid
    pixel = index % (height * width)
    row = _position(pixel // width, pixels=height, cells=rows) + index // (height * width) * rows
    column = _position(pixel % width, pixels=width, cells=columns)
    # grid_sample knows one image: that of all views below each other. Positions stay within their view.
    place = torch.stack([_from_minus_one(column, columns), _from_minus_one(row, views * rows)], dim=-1)
    sampled = grid_sample(
        rearrange(values, "b f c (row column) -> (b f) c row column", column=columns),
        rearrange(place, "b f ray xy -> (b f) 1 ray xy").to(values.dtype),
        padding_mode="border",
        align_corners=True,
    )
    return rearrange(sampled, "(b f) c 1 ray -> b f c ray", b=index.shape[0])


def _position(pixel: Int[Tensor, "*shape"], *, pixels: int, cells: int) -> Float[Tensor, "*shape"]:
    """Where the middle of a pixel is along one axis, in cells, 0 = the middle of the first.

    A cell is as many pixels long as it takes to cover the axis; the last one may stick out.
    """
    length = math.ceil(pixels / cells)
    return ((pixel + 0.5) / length - 0.5).clamp(min=0, max=cells - 1)


def _from_minus_one(position: Float[Tensor, "*shape"], cells: int) -> Float[Tensor, "*shape"]:
    """Positions 0..cells-1 as -1..1, as `grid_sample` wants them."""
    return position * (2 / max(cells - 1, 1)) - 1
