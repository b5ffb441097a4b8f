"""Shapes of objects from voxels of their fields, instead of volume rendering (paper, end of section Decoder).

Nothing has a gradient, because T_shape is a target.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
from einops import rearrange, reduce
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.geometry import from_box, full_precision
from obpose.model.nerf.compose import log_density
from obpose.model.nerf.field import Field
from obpose.types import Active, Boxes, Observation, Shape

MIN_VOXELS = 4
"""Smallest number of occupied voxels for which a shape counts as found. A cube of 3 cm fills about 6 of 12^3 in a box
of 20 cm. [ours; code: more than 10 of 24^3 in a box of 40 cm]"""
THRESHOLD = 0.5
"""sigma_T: occupancy above which a voxel belongs to the object. [code]"""
SUNK = 0.002
"""Distance below the table's surface in metres. Voxels that are farther below belong to no object. [code]"""

Codes = Float[Tensor, "batch frame slot latent"]


@dataclass(frozen=True, eq=False)
class Voxels:
    """Voxels of the objects' boxes."""

    points: Float[Tensor, "batch frame slot voxel 3"]
    """One point in each voxel, world frame, metres."""
    occupied: Bool[Tensor, "batch frame slot voxel"]


def estimate_shape(
    object_field: Field,
    boxes: Boxes,
    active: Active,
    z_what: Codes,
    observation: Observation,
    *,
    frame: Int[Tensor, " batch"] | None = None,
    **options: Any,
) -> Shape:
    """T_shape of every slot (paper, end of section Decoder), in one `frame` of each clip; nothing is found in others.

    Without `frame` all frames are used. Other arguments are those of `occupied_voxels`.
    """
    if frame is None:
        return shape_of(occupied_voxels(object_field, boxes, active, z_what, observation, **options))
    # Shapes in the chosen frames, put in their place among all frames.
    here = replace(boxes, center=_pick(boxes.center, frame), rotation=_pick(boxes.rotation, frame))
    images = {name: _pick(getattr(observation, name), frame) for name in ("rgb", "depth", "valid")}
    seen = Observation(**images, k=observation.k, world_from_camera=observation.world_from_camera)
    codes = _pick(z_what, frame)
    shape = shape_of(occupied_voxels(object_field, here, active, codes, seen, **options))
    at = torch.arange(z_what.shape[1], device=frame.device) == frame[:, None]
    return Shape(center=shape.center * at[..., None, None], found=shape.found & at[..., None])


@torch.no_grad()
def occupied_voxels(
    object_field: Field,
    boxes: Boxes,
    active: Active,
    z_what: Codes,
    observation: Observation,
    *,
    resolution: int,
    threshold: float = THRESHOLD,
    table: float = 0.0,
    generator: torch.Generator | None = None,
) -> Voxels:
    """Voxels where sigma_v = tanh(softplus(f(p_v, z_k))) > sigma_T (paper, end of section Decoder).

    Deviations, as in the authors' code: voxels below the table or in observed free space are empty and not evaluated.
    This removes the bias towards the visible side.

    Slots that are not `active` have no occupied voxels. `resolution` is S, voxels along an edge of a box, and
    `threshold` sigma_T. The `table` is the height of its surface in the world, metres. The generator draws a point in
    each voxel; without one it is the centre.
    """
    # Voxels that may be occupied: of active slots, above the table, not seen through.
    lattice = lattice_points(resolution, generator, boxes.center)
    points = from_box(lattice, boxes.center, boxes.rotation, boxes.size)
    possible = active[:, None, :, None] & ~observed_free(points, observation) & (points[..., 2] >= table - SUNK)
    index = possible.flatten().nonzero()[:, 0]
    owner, voxel = index // len(lattice), index % len(lattice)
    # Density at these voxels: tanh(softplus(f(p_v, z_k))).
    codes = object_field.condition(rearrange(z_what, "b f s d -> (b f s) d")).at(owner)
    logits, _ = object_field.density(lattice[voxel], codes)
    # Other voxels are empty.
    occupied = torch.zeros_like(possible).flatten()
    occupied[index] = occupancy(logits) > threshold
    return Voxels(points, occupied.view_as(possible))


def occupancy(logits: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Density of an object alone, over sigma_max (paper, end of section Decoder): tanh(softplus(sigma_k))."""
    return log_density(logits[..., None, :]).exp()


def lattice_points(resolution: int, generator: torch.Generator | None, like: Tensor) -> Float[Tensor, "voxel 3"]:
    """One point in each cell of the box -1..1: its centre, or drawn uniformly, the same for all boxes."""
    steps = torch.arange(resolution, dtype=like.dtype, device=like.device)
    corners = torch.cartesian_prod(steps, steps, steps)
    within = 0.5
    if generator is not None:
        within = torch.rand(corners.shape, generator=generator, dtype=like.dtype, device=like.device)
    return (corners + within) * (2 / resolution) - 1


@full_precision
def observed_free(
    points: Float[Tensor, "batch frame slot voxel 3"], observation: Observation
) -> Bool[Tensor, "batch frame slot voxel"]:
    """Whether a camera saw a surface behind the point."""
    # Pixels of the points.
    flat = rearrange(points, "b f s v xyz -> b f (s v) xyz")
    rotation, center = observation.world_from_camera[..., :3, :3], observation.world_from_camera[..., :3, 3]
    in_camera = torch.einsum("bfpi,bvij->bfvpj", flat, rotation)
    in_camera = in_camera - torch.einsum("bvi,bvij->bvj", center, rotation)[:, None, :, None]
    pixel = torch.einsum("bfvpi,bvji->bfvpj", in_camera, observation.k)
    before = pixel[..., 2] > 0
    column, row = (pixel[..., :2] / pixel[..., 2:].clamp(min=1e-6)).floor().unbind(-1)
    # Depth at these pixels.
    height, width = observation.depth.shape[-2:]
    seen = before & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    place = torch.where(seen, row * width + column, 0).long()
    depth = rearrange(observation.depth, "b f v h w -> b f v (h w)").gather(-1, place)
    valid = rearrange(observation.valid, "b f v h w -> b f v (h w)").gather(-1, place)
    # Free: some camera saw a surface behind the point.
    free = (seen & valid & (pixel[..., 2] < depth)).any(dim=2)
    return free.view(points.shape[:-1])


def shape_of(voxels: Voxels) -> Shape:
    """T_shape: the centre of the occupied voxels' bounding box along the world's axes.

    Deviation, as in the authors' code: the paper's T_shape is a mean of points, which depends on their density.
    """
    # Bounding box of the occupied voxels.
    found = voxels.occupied.sum(dim=-1) >= MIN_VOXELS
    without = ~voxels.occupied[..., None]
    low = reduce(voxels.points.masked_fill(without, torch.inf), "b f s v xyz -> b f s xyz", "min")
    high = reduce(voxels.points.masked_fill(without, -torch.inf), "b f s v xyz -> b f s xyz", "max")
    return Shape(center=torch.where(found[..., None], (low + high) / 2, 0.0), found=found)


def _pick(values: Tensor, frame: Int[Tensor, " batch"]) -> Tensor:
    return values[torch.arange(len(values), device=values.device), frame][:, None]
