"""Objects as grids of density and colour, aligned with gravity and the camera, and as large as the object.

Not in the paper; for `obpose.scenes.priors.flow`. Objects vary less in this frame than in their boxes: the vertical
axis is fixed, and the unseen side is always the far side.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from obpose.geometry import to_box
from obpose.model.nerf.detail import EDGE
from obpose.model.nerf.voxels import THRESHOLD, occupancy
from obpose.model.obpose import ObPose
from obpose.scenes.bounds import LEAST_VOXELS, above_table, shape_extent
from obpose.scenes.rendering import object_codes
from obpose.scenes.scene import Scene, upright

MARGIN = 0.015
"""Margin around the centres of occupied voxels, metres: more than a voxel, because the surface may be that far."""
DENSITY_LIMIT, COLOUR_LIMIT = 6.0, 4.0
"""Limits of the magnitude of logits; empty space has the lowest density."""
_ROUNDING = 1e-5


@dataclass(frozen=True, eq=False)
class Grids:
    """Grids of objects. Their axes point horizontally to the camera, horizontally to its right, and up."""

    values: Float[Tensor, "object edge edge edge 4"]
    """Logits of density and of colours as seen from the camera; `edge` is that of details."""
    half: Float[Tensor, "object"]
    """Half the edge of each grid, metres."""

    def take(self, places: Int[Tensor, " n"]) -> "Grids":
        """Select some of the objects."""
        return Grids(self.values[places], self.half[places])

    def apart(self) -> "list[Grids]":
        """Split into single objects."""
        return [self.take(torch.tensor([place])) for place in range(len(self.half))]


def together(grids: Sequence[Grids], like: Tensor) -> Grids:
    """Concatenate grids; if there are none, the empty result has the type of `like`."""
    none = Grids(like.new_zeros(0, EDGE, EDGE, EDGE, 4), like.new_zeros(0))
    parts = [none, *grids]
    return Grids(torch.cat([part.values for part in parts]), torch.cat([part.half for part in parts]))


@torch.no_grad()
def grids_of(model: ObPose, scene: Scene, frame: int) -> Grids:
    """Compute the grids of a frame's objects; those with hardly any density above the table are left out."""
    found = [grid for place in range(len(scene.ids)) if (grid := _grid(model, scene, frame, place))]
    return together(found, like=scene.what)


def facing(place: Float[Tensor, "3"], camera: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Give the rotation, world from grid, for an object and a camera at these positions."""
    x, y = (camera - place)[:2].tolist()
    return upright(math.atan2(y, x), place)


def _grid(model: ObPose, scene: Scene, frame: int, place: int) -> Grids | None:
    """Compute a grid as large as the dense part of a coarser grid around the occupied voxels."""
    center, camera = scene.center[frame, place], scene.cameras[0].world_from_camera[:3, 3]
    height = float(center[2]) - model.config.model.table_top
    world_from_grid = facing(center, camera)
    grid_from_box = world_from_grid.T @ scene.rotation[frame, place]
    codes = object_codes(model, scene, frame, place)
    sight = F.normalize(center - camera, dim=0) @ scene.rotation[frame, place]

    def around(dense: Float[Tensor, "n 3"], margin: float) -> tuple[Float[Tensor, "point 3"], Tensor, Tensor]:
        """Give points around dense ones, and the logits of density and colours there."""
        low, high = dense.amin(dim=0), dense.amax(dim=0)
        steps = torch.linspace(-1, 1, EDGE)
        points = torch.cartesian_prod(steps, steps, steps) * ((high - low).max() / 2 + margin) + (low + high) / 2
        inside = to_box(points, torch.zeros(3), grid_from_box, model.config.model.pose.box_size)
        density, hidden = model.object_field.density(inside, codes)
        colour = torch.logit(model.object_field.colour(hidden, sight.expand_as(inside), codes), eps=1e-3)
        nowhere = (inside.abs() > 1 + _ROUNDING).any(dim=-1) | (points[:, 2] + height < 0)
        return points, density.where(~nowhere, -DENSITY_LIMIT).clamp(-DENSITY_LIMIT, DENSITY_LIMIT), colour

    extent = above_table(shape_extent(model, codes, grid_from_box), height)
    if len(extent) < LEAST_VOXELS:
        return None
    points, density, _ = around(extent, MARGIN)
    dense = points[occupancy(density) > THRESHOLD]
    if len(dense) < LEAST_VOXELS:
        return None
    points, density, colour = around(dense, margin=float(points[1, 2] - points[0, 2]))
    # Colours of empty space are arbitrary; use the mean colour.
    density = density[:, None]
    share = torch.sigmoid(2 * density + 2)
    colour = share * colour + (1 - share) * mean_colour(density[None], colour[None])
    values = torch.cat([density, colour.clamp(-COLOUR_LIMIT, COLOUR_LIMIT)], dim=-1).view(1, EDGE, EDGE, EDGE, 4)
    return Grids(values, (points[-1, 2] - points[0, 2])[None] / 2)


def mean_colour(
    density: Float[Tensor, "object *point 1"], colour: Float[Tensor, "object *point 3"]
) -> Float[Tensor, "object 3"]:
    """Average the logits of colours, weighted by density."""
    weight = torch.sigmoid(2 * density).flatten(1, -2)
    return (colour.flatten(1, -2) * weight).sum(dim=1) / weight.sum(dim=1)
