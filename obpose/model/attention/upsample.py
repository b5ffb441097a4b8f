"""Masks of the embedding grid at pixels of the image, where losses compare them with the decoder (paper, 3)."""

import math

import torch
from einops import rearrange
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import grid_sample

from obpose.types import ComponentMasks, ComponentRays, GridValid

Index = Int[Tensor, "batch frame ray"]

_SMALLEST = -80.0
"""Log masks are not below this: e^-80 is about the smallest probability in single precision."""

_INVALID = 1e-20
"""Weight of a cell without a point: negligible, unless its neighbours have no points either."""


def masks_at(
    log_masks: ComponentMasks, valid: GridValid, index: Index, *, grid: tuple[int, int, int], size: tuple[int, int]
) -> ComponentRays:
    """Log of the masks at the pixels `index`, counted through all views, by bilinear interpolation of the masks.

    `grid` is (view, height, width) of the points, `size` (height, width) of the image. Invalid cells are left out, and
    the weights of the others sum to one, so that masks and scope still do. Deviation: the authors' code interpolates
    between the three nearest points in space, which needs a search.
    """
    # Weighted mean of the valid cells around each pixel.
    masks, present = log_masks.exp(), valid[:, :, None].to(log_masks.dtype).clamp(min=_INVALID)
    summed = _interpolate(torch.cat([masks * present, present], dim=2), index, grid=grid, size=size)
    mixed = summed[:, :, :-1] / summed[:, :, -1:]
    return mixed.clamp(min=math.exp(_SMALLEST)).log()


def _interpolate(
    values: Float[Tensor, "batch frame channel point"],
    index: Index,
    *,
    grid: tuple[int, int, int],
    size: tuple[int, int],
) -> Float[Tensor, "batch frame channel ray"]:
    (height, width), (views, rows, columns) = size, grid
    pixel = index % (height * width)
    # Positions of the pixels on the grid.
    row = _position(pixel // width, pixels=height, cells=rows) + index // (height * width) * rows
    column = _position(pixel % width, pixels=width, cells=columns)
    # The views below each other form one image for grid_sample. Positions stay within their view.
    place = torch.stack([_from_minus_one(column, columns), _from_minus_one(row, views * rows)], dim=-1)
    sampled = grid_sample(
        rearrange(values, "b f c (row column) -> (b f) c row column", column=columns),
        rearrange(place, "b f ray xy -> (b f) 1 ray xy").to(values.dtype),
        padding_mode="border",
        align_corners=True,
    )
    return rearrange(sampled, "(b f) c 1 ray -> b f c ray", b=index.shape[0])


def _position(pixel: Int[Tensor, "*shape"], *, pixels: int, cells: int) -> Float[Tensor, "*shape"]:
    """Position of a pixel's centre along one axis in cells, where 0 is the centre of the first cell.

    A cell has as many pixels as it takes to cover the axis; the last one may extend beyond the border.
    """
    length = math.ceil(pixels / cells)
    return ((pixel + 0.5) / length - 0.5).clamp(min=0, max=cells - 1)


def _from_minus_one(position: Float[Tensor, "*shape"], cells: int) -> Float[Tensor, "*shape"]:
    """Convert positions 0..cells-1 to the -1..1 of `grid_sample`."""
    return position * (2 / max(cells - 1, 1)) - 1
