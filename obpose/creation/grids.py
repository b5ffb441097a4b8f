"""An object as it lies, seen from where the camera is: densities and colours on a grid that is just as large.

An addition, for `obpose.creation.flow`. In such a frame objects differ less than in their boxes, which are turned by
how they were found: what is up is up, and what no camera has seen is on the far side.
"""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Float
from torch import Tensor

from obpose.creation.extent import LEAST_VOXELS, above_table, shape_extent
from obpose.creation.rendering import conditioning
from obpose.creation.scene import Scene, upright
from obpose.geometry import to_box
from obpose.model import ObPose
from obpose.nerf.detail import EDGE as DETAIL_EDGE
from obpose.nerf.detail import Lattices
from obpose.nerf.field import Conditioning

EDGE = 12
"""Points along each edge, the outermost on its faces."""
MARGIN = 0.015
"""Around the middles of occupied voxels, metres: more than a voxel, as the surface may be as far."""
DENSITY_LIMIT, COLOUR_LIMIT = 6.0, 4.0
"""Logits are at most so far from 0; densities at least are where nothing is."""
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class Grids:
    """Of one or more objects. The grids' axes point to the camera, to its right, both level, and up."""

    values: Float[Tensor, "object edge edge edge 4"]
    """Logits of density and colours, the latter seen from the camera; `edge` is `EDGE`."""
    half: Float[Tensor, "object"]
    """Half an edge, metres."""


@torch.no_grad()
def grids_of(model: ObPose, scene: Scene, frame: int) -> Grids:
    """Of a frame's objects, but for those that are hardly anywhere dense above the table."""
    found = [grid for place in range(len(scene.ids)) if (grid := _grid(model, scene, frame, place))]
    if not found:
        return Grids(scene.what.new_zeros(0, EDGE, EDGE, EDGE, 4), scene.what.new_zeros(0))
    values, half = zip(*found, strict=True)
    return Grids(torch.stack(values), torch.stack(half))


def facing(place: Float[Tensor, "3"], camera: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """World from grid where an object is at this place, and the camera there; below a camera any way will do."""
    x, y = (camera - place)[:2].tolist()
    return upright(math.atan2(y, x), place)


@torch.no_grad()
def as_details(model: ObPose, grids: Grids, what: Float[Tensor, "what"], sight: Float[Tensor, "3"]) -> Lattices:
    """Details with which a code's field is what the grids hold.

    Boxes have the grids' axes and their middles; what is outside of the box is cut off.

    Args:
        model: That the code is of.
        grids: Of one or more objects.
        what: One code for all.
        sight: Unit direction from the camera to the objects, axes of the grids.
    """
    half = model.config.model.pose.box_size / 2
    lattice = _points(DETAIL_EDGE)
    wanted = _interpolated(grids, lattice * half)
    density, colour = _logits(model, model.object_field.condition(what), lattice, sight)
    alone = torch.cat([density[:, None], colour], dim=-1)
    return (wanted - alone).unflatten(1, (DETAIL_EDGE,) * 3)


def _grid(
    model: ObPose, scene: Scene, frame: int, place: int
) -> tuple[Float[Tensor, "edge edge edge 4"], Float[Tensor, ""]] | None:
    center, camera = scene.center[frame, place], scene.cameras[0].world_from_camera[:3, 3]
    world_from_grid = facing(center, camera)
    grid_from_box = world_from_grid.T @ scene.rotation[frame, place]
    codes = conditioning(model, scene.what[frame, place], scene.detail[place])
    extent = above_table(shape_extent(model, codes, grid_from_box), float(center[2]))
    if len(extent) < LEAST_VOXELS:
        return None
    low, high = extent.amin(dim=0), extent.amax(dim=0)
    half = (high - low).max() / 2 + MARGIN
    points = _points(EDGE) * half + (low + high) / 2
    inside = to_box(points, torch.zeros(3), grid_from_box, model.config.model.pose.box_size)
    sight = F.normalize(center - camera, dim=0)
    density, colour = _logits(model, codes, inside, grid_from_box.T @ (world_from_grid.T @ sight))
    nowhere = (inside.abs() > 1 + _ROUNDING).any(dim=-1) | (points[:, 2] + center[2] < 0)
    density = density.where(~nowhere, -DENSITY_LIMIT).clamp(-DENSITY_LIMIT, DENSITY_LIMIT)[:, None]
    # Where nothing is the field's colours mean nothing.
    share = torch.sigmoid(2 * density + 2)
    mean = (colour * torch.sigmoid(2 * density)).sum(dim=0) / torch.sigmoid(2 * density).sum()
    colour = (share * colour + (1 - share) * mean).clamp(-COLOUR_LIMIT, COLOUR_LIMIT)
    return torch.cat([density, colour], dim=-1).unflatten(0, (EDGE,) * 3), half


def _logits(
    model: ObPose, codes: Conditioning, points: Float[Tensor, "point 3"], sight: Float[Tensor, "3"]
) -> tuple[Float[Tensor, "point"], Float[Tensor, "point 3"]]:
    """Of density and colours at points of the box -1..1; `sight` is in the box's axes."""
    density, hidden = model.object_field.density(points, codes)
    colour = model.object_field.colour(hidden, sight.expand_as(points), codes)
    return density, torch.logit(colour, eps=1e-3)


def _interpolated(grids: Grids, points: Float[Tensor, "point 3"]) -> Float[Tensor, "object point 4"]:
    """Trilinear, at points in metres around the grids' middles; beyond their faces nothing is dense."""
    inside = points / grids.half[:, None, None]
    # grid_sample has the last axis of the values first.
    at = inside.flip(-1)[:, None, None]
    found = F.grid_sample(
        rearrange(grids.values, "object x y z value -> object value x y z"),
        at,
        align_corners=True,
        padding_mode="border",
    )
    values = rearrange(found, "object value 1 1 point -> object point value")
    beyond = (inside.abs() > 1 + _ROUNDING).any(dim=-1, keepdim=True)
    empty = values.new_tensor([True, False, False, False], dtype=torch.bool)
    return values.masked_fill(beyond & empty, -DENSITY_LIMIT)


def _points(edge: int) -> Float[Tensor, "point 3"]:
    """-1..1, the outermost on the faces."""
    steps = torch.linspace(-1, 1, edge)
    return torch.cartesian_prod(steps, steps, steps)
