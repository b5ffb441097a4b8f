"""Bounds of objects: the workspace that the model was trained on, above the table, and the occupied part of a box."""

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.errors import UsageError
from obpose.geometry import from_box
from obpose.model.nerf.field import Conditioning
from obpose.model.nerf.voxels import THRESHOLD, lattice_points, occupancy
from obpose.model.obpose import ObPose
from obpose.scenes.scene import Scene

_SUNK = 0.01
"""Tolerance for box centres below the table, metres; inferred thin objects need it."""


def workspace_bounds(model: ObPose) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"]]:
    """Give the lowest and highest corner of the allowed box centres, world frame, metres.

    They bound the cube that the cameras saw in training. If the model has a table, the part below it is excluded,
    because nothing is rendered there.
    """
    settings = model.config.model
    half = settings.workspace_size / 2
    low, high = model.center - half, model.center + half
    if settings.table is not None:
        low = torch.cat([low[:2], low[2:].clamp(min=settings.table_top)])
    return low, high


def objects_outside(scene: Scene, model: ObPose) -> list[int]:
    """Names of the objects that are outside the workspace in some frame."""
    low, high = workspace_bounds(model)
    lowest = low - torch.tensor([0.0, 0.0, _SUNK])
    outside = ((scene.center < lowest) | (scene.center > high)).any(dim=2).any(dim=0).tolist()
    return [name for name, out in zip(scene.ids, outside, strict=True) if out]


def check_inside(scene: Scene, model: ObPose) -> None:
    """Check that all objects are inside the workspace in all frames.

    Raises:
        UsageError: some are outside; the message lists them and the bounds.
    """
    if names := objects_outside(scene, model):
        low, high = workspace_bounds(model)
        within = zip("xyz", (low * 100).ceil() / 100, (high * 100).floor() / 100, strict=True)
        ranges = [f"{axis} {a:.2f} to {b:.2f}" for axis, a, b in within]
        raise UsageError(
            f"Object {', '.join(map(str, names))} would be outside the workspace of the model; expected the middle of "
            f"its box at {', '.join(ranges)} m in all frames: put it there, or in frames of your own move the world."
        )


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
    """Keep the voxels above the table, for a box centre at this height above its surface, metres."""
    return extent[extent[:, 2] > -height]


def shape_extent(model: ObPose, codes: Conditioning, rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "corner 3"]:
    """Give the occupied voxels relative to the box centre, world axes, metres; the centre if none is occupied."""
    voxels = occupied(model, codes)
    if not len(voxels):
        voxels = voxels.new_zeros(1, 3)
    return from_box(voxels, torch.zeros(3), rotation, model.config.model.pose.box_size)
