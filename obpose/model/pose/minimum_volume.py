"""Orientation of an object: that of the tightest box around its points, followed through the frames.

The paper's *minimum volume principle* (section Object Location and Orientation Conditioned Encoding): of many rotations
keep those whose axis-aligned box around the rotated points is nearly the smallest, and take the one nearest to the
orientation in the frame before. Nothing has a gradient.
"""

import math
from dataclasses import dataclass

import torch
from einops import rearrange, repeat
from jaxtyping import Bool, Float
from torch import Tensor

from obpose.geometry import full_precision
from obpose.model.pose.rotations import (
    box_grid,
    box_rotations,
    healpix_directions,
    rotation_from_vector,
    small_rotations,
)

Candidates = Float[Tensor, "box candidate 3 3"]
Rotations = Float[Tensor, "box 3 3"]

GRID_LEVEL = 1
"""HEALPix level of the rotation grid before refinement. Of its 576 (1) or 4608 (2) rotations, the 24 or 204 that are
distinct under the symmetry of a box are used. [code: 3, all 36,864]"""
REFINEMENTS = 8
"""Rounds of local refinement; the last one rotates boxes by at most 0.6 degrees. [ours]"""
TOLERANCE = 0.01
"""beta: boxes of up to 1 + beta times the smallest volume are candidates. [code]"""
_STARTS = 8
"""Number of rotations of the grid that are refined."""
_SCATTERED = 9
"""Number of rotations tried around each in a round, beside those about the axes of its box."""
_REACH = math.radians(40)
"""Largest angle of tried rotations in the first round at level 0 of the grid; half at each further level."""
_SHRINK = 0.6
"""Factor on this angle from round to round."""
_THICKNESS = 1e-2
"""Length added to the edges of a box, in units of the cloud's radius, because boxes of flat clouds have no volume."""


@dataclass(frozen=True, eq=False)
class Clouds:
    """Point clouds. The point axis comes first, which makes extremes cheap to find."""

    points: Float[Tensor, "point *box 3"]
    """Relative to the middle of the cloud, along the world's axes, metres. Invalid points copy a valid one."""
    thickness: Float[Tensor, "*box"]
    """Metres to add to each edge of a box."""


@torch.no_grad()
@full_precision
def orient(
    points: Float[Tensor, "batch frame slot point 3"],
    valid: Bool[Tensor, "batch frame slot point"],
    *,
    min_points: int,
    grid_level: int = GRID_LEVEL,
    refinements: int = REFINEMENTS,
    tolerance: float = TOLERANCE,
) -> Float[Tensor, "batch frame slot 3 3"]:
    """R, world from object, of every object in every frame, from its observed points in the world frame.

    Columns are the axes of its box. See `find_candidates` for `grid_level` and `refinements`, `follow` for `tolerance`.
    An object with fewer than `min_points` points keeps the orientation of the frame before, initially the identity.
    """
    batch, frames = points.shape[:2]
    # Candidates of all frames at once, then frame by frame the nearest one.
    clouds = gather_clouds(
        rearrange(points.float(), "b f s point xyz -> (f b s) point xyz"),
        rearrange(valid, "b f s point -> (f b s) point"),
    )
    candidates = find_candidates(clouds, grid_level=grid_level, refinements=refinements)
    # Frame by frame the nearest of the nearly smallest boxes (paper, same section).
    rotation = follow(
        Clouds(
            rearrange(clouds.points, "point (f box) xyz -> point f box xyz", f=frames),
            rearrange(clouds.thickness, "(f box) -> f box", f=frames),
        ),
        rearrange(candidates, "(f box) c i j -> f box c i j", f=frames),
        rearrange(valid.sum(dim=-1) >= min_points, "b f s -> f (b s)"),
        tolerance=tolerance,
    )
    return rearrange(rotation, "f (b s) i j -> b f s i j", b=batch)


def gather_clouds(points: Float[Tensor, "box point 3"], valid: Bool[Tensor, "box point"]) -> Clouds:
    """Centre points on the middle of their bounding box, and replace invalid ones by a valid one."""
    first = repeat(valid.int().argmax(dim=-1), "box -> box 1 xyz", xyz=3)
    there = torch.where(valid[..., None], points, points.gather(1, first))
    middle = (there.amin(dim=1, keepdim=True) + there.amax(dim=1, keepdim=True)) / 2
    centred = rearrange(there - middle, "box point xyz -> point box xyz").contiguous()
    return Clouds(centred, _THICKNESS * centred.norm(dim=-1).amax(dim=0))


def find_candidates(clouds: Clouds, *, grid_level: int = GRID_LEVEL, refinements: int = REFINEMENTS) -> Candidates:
    """Find orientations of small boxes around each cloud.

    The paper takes them from an equivolumetric grid: HEALPix directions times rotations about them. Deviations: one of
    each 24 rotations of the grid (of level `grid_level`) with the same box is tried, and the best are refined in
    `refinements` rounds, because the best of 36,864 rotations still has a box 17 % too large. Only the outermost points
    are used.
    """
    corners = _outermost(clouds)
    # Smallest boxes of the grid.
    grid = box_grid(grid_level).to(corners.points)
    smallest = _shared_volumes(corners, grid).topk(min(_STARTS, len(grid)), dim=-1, largest=False)
    rotation = grid[smallest.indices]
    # Local refinement: R becomes the R T with the smallest box, for rotations T by shrinking angles.
    identity, starts = torch.eye(3), rotation.shape[1]
    for turn in range(refinements):
        # The identity, so that no box grows; about the box's own axes, to stay flush with a side; scattered ones.
        reach = _REACH / 2**grid_level * _SHRINK**turn
        own_axes = rotation_from_vector(reach * torch.cat([identity, -identity]))
        tried = torch.cat([identity[None], own_axes, small_rotations(_SCATTERED, reach)]).to(rotation)
        # In the frames R, the rotations T are the same for all clouds.
        turned = Clouds(_into(rotation, corners.points), repeat(corners.thickness, "box -> box start", start=starts))
        rotation = rotation @ tried[_shared_volumes(turned, tried).argmin(dim=-1)]
    return rotation


def follow(
    clouds: Clouds,
    candidates: Float[Tensor, "frame box candidate 3 3"],
    seen: Bool[Tensor, "frame box"],
    *,
    tolerance: float = TOLERANCE,
) -> Float[Tensor, "frame box 3 3"]:
    """Choose in each frame, among the nearly smallest boxes, the one nearest to the frame before (paper, same section).

    Volumes of these boxes are in [V_min, (1 + beta) V_min] with `tolerance` as beta. Of their 24 orientations each, the
    one with the smallest geodesic distance to the frame before (first: to the identity) is chosen. The orientation of
    the frame before is itself a candidate, as in a fine grid, and is kept in frames in which an object is not `seen`.
    """
    before = repeat(torch.eye(3).to(candidates), "i j -> box i j", box=candidates.shape[1])
    orientations = []
    for frame, found in enumerate(candidates):
        rotation = torch.cat([found, before[:, None]], dim=1)
        volume = _volumes(Clouds(clouds.points[:, frame], clouds.thickness[frame]), rotation)
        # Candidates: volumes in [V_min, (1 + beta) V_min].
        small = volume <= (1 + tolerance) * volume.amin(dim=-1, keepdim=True)
        # Objects out of sight keep their orientation.
        before = torch.where(seen[frame, :, None, None], _nearest(rotation, small, before), before)
        orientations.append(before)
    return torch.stack(orientations)


def _volumes(clouds: Clouds, rotation: Candidates) -> Float[Tensor, "box candidate"]:
    """Volumes of the boxes along the axes of these rotations."""
    return _aligned_volume(_into(rotation, clouds.points), clouds.thickness[:, None])


def _shared_volumes(clouds: Clouds, rotations: Float[Tensor, "rotation 3 3"]) -> Float[Tensor, "*box rotation"]:
    """Volumes for rotations that all clouds share, by one matrix product."""
    every = rearrange(clouds.points, "point ... xyz -> (point ...) xyz")
    along = every @ rearrange(rotations, "rotation xyz edge -> xyz (rotation edge)")
    return _aligned_volume(along.reshape(*clouds.points.shape[:-1], -1, 3), clouds.thickness[..., None])


def _aligned_volume(points: Tensor, thickness: Tensor) -> Tensor:
    """Volumes of the axis-aligned boxes around points (the first axis), with some thickness added to each edge."""
    return (points.amax(dim=0) - points.amin(dim=0) + thickness[..., None]).prod(dim=-1)


def _into(rotation: Candidates, points: Float[Tensor, "point box 3"]) -> Float[Tensor, "point box candidate 3"]:
    """Coordinates in each rotated frame: R^-1 p."""
    return torch.einsum("pbi,bcij->pbcj", points, rotation)


def _outermost(clouds: Clouds) -> Clouds:
    """Select the extreme points of each cloud in 24 directions and their opposites, which are near hull corners."""
    half = healpix_directions(1).chunk(2)[0].to(clouds.points)
    along = clouds.points @ half.mT
    # Extreme points in each direction and its opposite.
    index = torch.cat([along.max(dim=0).indices, along.min(dim=0).indices], dim=-1)
    corners = clouds.points.gather(0, repeat(index, "box corner -> corner box xyz", xyz=3))
    return Clouds(corners, clouds.thickness)


def _nearest(rotation: Candidates, small: Bool[Tensor, "box candidate"], before: Rotations) -> Rotations:
    """Choose among the 24 orientations of each `small` box the one with the largest trace of before^-1 R.

    The paper's geodesic distance falls as the trace grows, so its arccos is not needed.
    """
    named = box_rotations().to(rotation)
    # tr(before^-1 R E) for each of the 24 rotations E.
    relative = before[:, None].mT @ rotation
    traces = torch.einsum("bcij,eji->bce", relative, named).masked_fill(~small[..., None], -torch.inf)
    best = traces.flatten(start_dim=1).argmax(dim=-1)
    boxes = torch.arange(len(best), device=best.device)
    return rotation[boxes, best // 24] @ named[best % 24]
