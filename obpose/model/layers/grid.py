"""Organised point clouds: points on the grids of images, the 3x3 windows around them, coarser and finer grids.

What is not valid never reaches what is: as a neighbour it has influence 0, and upsampling leaves it out.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from einops import rearrange, repeat
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.model.layers.kpconv import influence

FAR = 1e6
"""Where points that are not valid are put as neighbours, in radii: out of reach of every kernel point."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Points of several images."""

    points: Float[Tensor, "image height width 3"]
    """World frame, metres; 0 where not valid."""
    valid: Bool[Tensor, "image height width"]


@dataclass(frozen=True, eq=False)
class Windows:
    """Neighbours of some points of a grid, and what a KPConv needs to know of them."""

    neighbours: Int[Tensor, "point 9"]
    """Places among all points of the grid."""
    influences: Float[Tensor, "point 9 kernel"]
    """0 for neighbours that are not valid or would lie beyond the border."""

    def gather(self, features: Float[Tensor, "all channel"]) -> Float[Tensor, "point 9 channel"]:
        """Features of the neighbours, from those of all points of the grid."""
        return features.index_select(0, self.neighbours.flatten()).unflatten(0, self.neighbours.shape)

    def at(self, rows: Int[Tensor, " kept"]) -> "Windows":
        """Those of some of the points."""
        return Windows(self.neighbours.index_select(0, rows), self.influences.index_select(0, rows))


def windows(grid: Grid, places: Int[Tensor, " point"], *, radius: float, kernel: Float[Tensor, "kernel 3"]) -> Windows:
    """The 3x3 windows around the points at `places`, with influences for neighbourhoods of `radius` metres."""
    height, width = grid.valid.shape[1:]
    beyond = grid.valid.numel()
    step = torch.arange(-1, 2, device=places.device)
    row, column = (places // width % height)[:, None] + step, (places % width)[:, None] + step
    inside = ((row >= 0) & (row < height))[:, :, None] & ((column >= 0) & (column < width))[:, None]
    neighbours = places[:, None] + (width * step[:, None] + step).flatten()
    points = grid.points.reshape(-1, 3) / radius
    apart = F.pad(points.masked_fill(~grid.valid.view(-1, 1), FAR), (0, 0, 0, 1), value=FAR)
    around = apart.index_select(0, neighbours.where(inside.flatten(1), beyond).flatten()).view(-1, 9, 3)
    return Windows(neighbours.clamp(0, beyond - 1), influence(around - points[places][:, None], kernel))


def all_places(grid: Grid) -> Int[Tensor, " point"]:
    """Places of all points of a grid: image by image and row by row."""
    return torch.arange(grid.valid.numel(), device=grid.valid.device)


def on_grid(features: Float[Tensor, "point channel"], grid: Grid) -> Float[Tensor, "image height width channel"]:
    """Features of all points, by image, row and column."""
    return features.unflatten(0, grid.valid.shape)


def thin(grid: Grid, stride: int) -> tuple[Grid, Int[Tensor, " kept"]]:
    """Keeps one point of each cell of stride x stride: of those that are valid the nearest to its middle.

    Also gives their places among all points of the grid. Cells at the right and lower border may be smaller; one
    without a valid point stays without. The authors' code thins by farthest points, which the paper leaves open.
    """
    height, width = grid.valid.shape[1:]
    cells = F.pad(grid.valid, (0, -width % stride, 0, -height % stride))
    cells = rearrange(cells, "image (y row) (x column) -> image y x (row column)", row=stride, column=stride)
    order = _from_the_middle(stride).to(cells.device)
    best = order[cells[..., order].to(torch.uint8).argmax(-1)]
    within = (torch.arange(stride)[:, None] * width + torch.arange(stride)).flatten().to(cells.device)
    corners = all_places(grid).view(grid.valid.shape)[:, ::stride, ::stride]
    places = (corners + within[best]).clamp(max=grid.valid.numel() - 1)
    valid = cells.any(-1)
    points = grid.points.view(-1, 3)[places].masked_fill(~valid[..., None], 0)
    return Grid(points, valid), places.flatten()


def upsample(
    features: Float[Tensor, "image rows columns channel"], valid: Bool[Tensor, "image rows columns"], *, like: Grid
) -> Float[Tensor, "image height width channel"]:
    """Bilinear upsampling by two that leaves out what is not valid; 0 where nothing valid is near.

    The paper says trilinear; on the grid of an image there are two axes.
    """
    height, width = like.valid.shape[1:]
    weight = valid[..., None].to(features.dtype)
    fine, share = (_twice_as_fine(values)[:, :height, :width] for values in (features * weight, weight))
    return fine * share.clamp(min=1e-3).reciprocal()


def _twice_as_fine(values: Float[Tensor, "image y x channel"]) -> Float[Tensor, "image yy xx channel"]:
    images = rearrange(values, "image y x channel -> image channel y x")
    fine = F.interpolate(images, scale_factor=2, mode="bilinear", align_corners=False)
    return rearrange(fine, "image channel y x -> image y x channel")


def _from_the_middle(stride: int) -> Int[Tensor, " cell"]:
    distance = (torch.arange(stride) - (stride - 1) / 2).square()
    return (repeat(distance, "x -> y x", y=stride) + distance[:, None]).flatten().argsort(stable=True)
