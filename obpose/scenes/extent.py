"""How much of its box an object fills."""

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.geometry import from_box
from obpose.model.nerf.field import Conditioning
from obpose.model.nerf.voxels import THRESHOLD, lattice_points, occupancy
from obpose.model.obpose import ObPose

LEAST_VOXELS = 8
"""Objects of fewer of these voxels are hardly anywhere: in boxes of 20 cm it is a cube of 25 mm."""
CELLS = 16
"""Voxels along each edge of a box, or of what an object's detail is alone in."""


@torch.no_grad()
def occupied(model: ObPose, codes: Conditioning) -> Float[Tensor, "voxel 3"]:
    """Middles of the voxels that the object of a single code is in, in its box.

    Voxels are parts of the box, or of what an object's detail is alone in.
    """
    lattice = lattice_points(CELLS, None, codes.first)
    if codes.detail is not None and codes.detail.alone is not None:
        lattice = lattice * codes.detail.alone
        lattice = lattice[(lattice.abs() <= 1).all(dim=-1)]
    logits, _ = model.object_field.density(lattice, codes)
    return lattice[occupancy(logits) > THRESHOLD]


def above_table(extent: Float[Tensor, "corner 3"], height: float) -> Float[Tensor, "some 3"]:
    """Those of the voxels that are above the world's z = 0 where the middle of the box is so high, metres."""
    return extent[extent[:, 2] > -height]


def shape_extent(model: ObPose, codes: Conditioning, rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "corner 3"]:
    """Occupied voxels of an object relative to the middle of its box, world axes, metres; the middle if none is."""
    voxels = occupied(model, codes)
    if not len(voxels):
        voxels = voxels.new_zeros(1, 3)
    return from_box(voxels, torch.zeros(3), rotation, model.config.model.pose.box_size)
