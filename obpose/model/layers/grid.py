"""Organised point clouds: points on the grids of images, the 3x3 windows around them, coarser and finer grids.

Invalid points never influence valid ones: as neighbours they have influence 0, and upsampling ignores them.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.model.layers.kpconv import influence

FAR = 1e6
"""Coordinate of invalid neighbours, in radii: out of reach of every kernel point."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Points of several images."""

    points: Float[Tensor, "image height width 3"]
    """Surface points, world frame, metres; 0 where not valid."""
    valid: Bool[Tensor, "image height width"]


@dataclass(frozen=True, eq=False)
class Windows:
    """Neighbours of some points of a grid, and their influences in a KPConv."""

    neighbours: Int[Tensor, "point 9"]
    """Indices among all points of the grid."""
    influences: Float[Tensor, "point 9 kernel"]
    """0 for invalid neighbours and for those beyond the border."""

    def gather(self, features: Float[Tensor, "all channel"]) -> Float[Tensor, "point 9 channel"]:
        """Select the neighbours' features from those of all points of the grid."""
        return features.index_select(0, self.neighbours.flatten()).unflatten(0, self.neighbours.shape)

    def at(self, rows: Int[Tensor, " kept"]) -> "Windows":
        """Select the windows of some points."""
        return Windows(self.neighbours.index_select(0, rows), self.influences.index_select(0, rows))


def windows(grid: Grid, places: Int[Tensor, " point"], *, radius: float, kernel: Float[Tensor, "kernel 3"]) -> Windows:
    """Find the 3x3 windows around the points `places`, with influences for neighbourhoods of `radius` metres."""
    height, width = grid.valid.shape[1:]
    beyond = grid.valid.numel()
    step = torch.arange(-1, 2, device=places.device)
    # Neighbours in the image, which may be beyond the border.
    row, column = (places // width % height)[:, None] + step, (places % width)[:, None] + step
    inside = ((row >= 0) & (row < height))[:, :, None] & ((column >= 0) & (column < width))[:, None]
    neighbours = places[:, None] + (width * step[:, None] + step).flatten()
    # Invalid neighbours are moved out of reach.
    points = grid.points.reshape(-1, 3) / radius
    apart = F.pad(points.masked_fill(~grid.valid.view(-1, 1), FAR), (0, 0, 0, 1), value=FAR)
    around = apart.index_select(0, neighbours.where(inside.flatten(1), beyond).flatten()).view(-1, 9, 3)
    return Windows(neighbours.clamp(0, beyond - 1), influence(around - points[places][:, None], kernel))


def all_places(grid: Grid) -> Int[Tensor, " point"]:
    """Indices of all points of a grid, image by image and row by row."""
    return torch.arange(grid.valid.numel(), device=grid.valid.device)


def on_grid(features: Float[Tensor, "point channel"], grid: Grid) -> Float[Tensor, "image height width channel"]:
    """Arrange the features of all points by image, row and column."""
    return features.unflatten(0, grid.valid.shape)


def subsample(grid: Grid) -> tuple[Grid, Int[Tensor, " kept"]]:
    """Keep the first valid point of each 2x2 cell; also give the kept points' indices among all points of the grid.

    Cells at the right and lower border may be smaller; one without a valid point stays without. The authors' code uses
    farthest point sampling, which the paper leaves open.
    """
    height, width = grid.valid.shape[1:]
    # Valid points of each cell.
    cells = F.pad(grid.valid, (0, -width % 2, 0, -height % 2))
    cells = rearrange(cells, "image (y row) (x column) -> image y x (row column)", row=2, column=2)
    best = cells.to(torch.uint8).argmax(-1)
    # Index of the first one.
    within = torch.tensor([0, 1, width, width + 1], device=cells.device)
    corners = all_places(grid).view(grid.valid.shape)[:, ::2, ::2]
    places = (corners + within[best]).clamp(max=grid.valid.numel() - 1)
    valid = cells.any(-1)
    points = grid.points.view(-1, 3)[places].masked_fill(~valid[..., None], 0)
    return Grid(points, valid), places.flatten()


def upsample(
    features: Float[Tensor, "image rows columns channel"], valid: Bool[Tensor, "image rows columns"], *, like: Grid
) -> Float[Tensor, "image height width channel"]:
    """Upsample by two, bilinearly, over valid points only; 0 where none is near.

    The paper says trilinear, but the grid of an image has two axes.
    """
    height, width = like.valid.shape[1:]
    weight = valid[..., None].to(features.dtype)
    fine, share = (_twice_as_fine(values)[:, :height, :width] for values in (features * weight, weight))
    return fine * share.clamp(min=1e-3).reciprocal()


def _twice_as_fine(values: Float[Tensor, "image y x channel"]) -> Float[Tensor, "image yy xx channel"]:
    images = rearrange(values, "image y x channel -> image channel y x")
    fine = F.interpolate(images, scale_factor=2, mode="bilinear", align_corners=False)
    return rearrange(fine, "image channel y x -> image y x channel")
