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
pixels than this. [code: 10 points]"""
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
    chosen, valid = _some_of_each(rearrange(owners, "b f v h w -> b f (v h w)"), slots, _POINTS)
    flat = rearrange(points, "b f v h w c -> b f 1 (v h w) c").expand(-1, -1, slots, -1, -1)
    return orient(flat.gather(-2, repeat(chosen, "b f s n -> b f s n 3")), valid, min_points=MIN_PIXELS)


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
