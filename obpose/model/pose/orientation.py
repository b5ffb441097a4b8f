"""Orientations of objects, from the image's pixels.

Paper, section Object Location and Orientation Conditioned Encoding.
"""

import torch
from einops import rearrange, repeat
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.model.pose.minimum_volume import orient

MIN_PIXELS = 10
"""A slot keeps its orientation from the previous frame, initially the identity, if it has the largest mask at fewer
pixels than this. Pixels of an object that stands count twice in `standing_boxes`. [code: 10 points]"""
STANDING = 0.03
"""Height of the lowest visible point, metres above the table, below which an object stands on the table."""
_POINTS = 256
"""Number of surface points of an object, spread over its pixels, that determine its orientation."""


@torch.no_grad()
def observed_rotation(
    points: Float[Tensor, "batch frame view height width 3"],
    owners: Int[Tensor, "batch frame view height width"],
    *,
    slots: int,
) -> Float[Tensor, "batch frame slot 3 3"]:
    """R, world from object: the tightest boxes around the surface points whose largest mask is the slot's.

    Deviation: the points of the image's pixels, which are finer than the paper's points of the embedding grid.
    """
    return orient(*_own_points(points, owners, slots), min_points=MIN_PIXELS)


@torch.no_grad()
def standing_boxes(
    points: Float[Tensor, "batch frame view height width 3"],
    owners: Int[Tensor, "batch frame view height width"],
    *,
    slots: int,
    table: float,
) -> tuple[
    Float[Tensor, "batch frame slot 3"], Float[Tensor, "batch frame slot 3 3"], Bool[Tensor, "batch frame slot"]
]:
    """T and R of every slot by the smallest box around its points and, if it stands on the table, their feet.

    An addition to the paper. A camera above the table does not see the lower part of an object, but mostly knows where
    it ends.

    Args:
        points: Surface points, world frame, metres.
        owners: Slot with the largest mask at each pixel, from 1; 0 is the background.
        slots: Number of slots.
        table: Height of the table, metres.

    Returns:
        Middle of the box, the origin without points; R, world from object; and whether the slot has any points.
    """
    own, valid = _own_points(points, owners, slots)
    heights = own[..., 2].masked_fill(~valid, torch.inf)
    stands = heights.amin(dim=-1, keepdim=True) < table + STANDING
    feet = torch.cat([own[..., :2], torch.full_like(own[..., 2:], table)], dim=-1)
    own, valid = torch.cat([own, feet], dim=-2), torch.cat([valid, valid & stands], dim=-1)
    rotation = orient(own, valid, min_points=MIN_PIXELS)
    # Middle of the extent along each axis of the box.
    local, outside = torch.einsum("bfsni,bfsij->bfsnj", own, rotation), ~valid[..., None]
    low, high = local.masked_fill(outside, torch.inf).amin(-2), local.masked_fill(outside, -torch.inf).amax(-2)
    found = valid.any(dim=-1)
    middle = torch.where(found[..., None], (low + high) / 2, 0.0)
    return torch.einsum("bfsij,bfsj->bfsi", rotation, middle), rotation, found


def _own_points(
    points: Float[Tensor, "batch frame view height width 3"],
    owners: Int[Tensor, "batch frame view height width"],
    slots: int,
) -> tuple[Float[Tensor, "batch frame slot point 3"], Bool[Tensor, "batch frame slot point"]]:
    """Gather up to `_POINTS` points of each slot, and say which of them are valid."""
    chosen, valid = _some_of_each(rearrange(owners, "b f v h w -> b f (v h w)"), slots, _POINTS)
    flat = rearrange(points, "b f v h w c -> b f 1 (v h w) c").expand(-1, -1, slots, -1, -1)
    return flat.gather(-2, repeat(chosen, "b f s n -> b f s n 3")), valid


def _some_of_each(
    owners: Int[Tensor, "batch frame pixel"], slots: int, count: int
) -> tuple[Int[Tensor, "batch frame slot point"], Bool[Tensor, "batch frame slot point"]]:
    """Choose at most `count` pixels of each slot, spread evenly in raster order; also say which are valid."""
    mine = owners[:, :, None] == torch.arange(1, slots + 1, device=owners.device)[:, None]
    rank = mine.cumsum(dim=-1) - 1
    total = mine.sum(dim=-1, keepdim=True)
    # A pixel is kept if the running share of `count` passes a whole number there.
    kept = mine & ((rank + 1) * count // total.clamp(min=count) > rank * count // total.clamp(min=count))
    best = kept.to(torch.uint8).topk(min(count, kept.shape[-1]), dim=-1, sorted=False)
    return best.indices, best.values.bool()
