"""Occupied part of an object's box."""

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.geometry import from_box
from obpose.model.nerf.field import Conditioning
from obpose.model.nerf.voxels import THRESHOLD, lattice_points, occupancy
from obpose.model.obpose import ObPose

LEAST_VOXELS = 8
"""Least number of occupied voxels of an object: a cube of 25 mm in a box of 20 cm."""
CELLS = 16
"""Voxels along each edge of a box, or of a residual grid that replaces the field."""


@torch.no_grad()
def occupied(model: ObPose, codes: Conditioning) -> Float[Tensor, "voxel 3"]:
    """Give the centres of the occupied voxels of an object with a single code, in box coordinates.

    Voxels divide the box, or the residual grid if it replaces the field.
    """
    lattice = lattice_points(CELLS, None, codes.first)
    if codes.detail is not None and codes.detail.own_scale is not None:
        lattice = lattice * codes.detail.own_scale
        lattice = lattice[(lattice.abs() <= 1).all(dim=-1)]
    logits, _ = model.object_field.density(lattice, codes)
    return lattice[occupancy(logits) > THRESHOLD]


def above_table(extent: Float[Tensor, "corner 3"], height: float) -> Float[Tensor, "some 3"]:
    """Keep the voxels above the world's z = 0, for a box centre at this height, metres."""
    return extent[extent[:, 2] > -height]


def shape_extent(model: ObPose, codes: Conditioning, rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "corner 3"]:
    """Give the occupied voxels relative to the box centre, world axes, metres; the centre if none is occupied."""
    voxels = occupied(model, codes)
    if not len(voxels):
        voxels = voxels.new_zeros(1, 3)
    return from_box(voxels, torch.zeros(3), rotation, model.config.model.pose.box_size)
