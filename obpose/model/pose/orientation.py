"""How objects are turned, from the image's pixels.

Paper, section Object Location and Orientation Conditioned Encoding.
"""

import torch
from einops import rearrange, repeat
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.config import PoseConfig
from obpose.model.pose.minimum_volume import orient

_POINTS = 256
"""So many surface points of an object, spread over its pixels, its orientation is found from."""


@torch.no_grad()
def observed_rotation(
    points: Float[Tensor, "batch frame view height width 3"],
    owners: Int[Tensor, "batch frame view height width"],
    *,
    slots: int,
    pose: PoseConfig,
) -> Float[Tensor, "batch frame slot 3 3"]:
    """R, world from object: the tightest boxes around the surface points whose largest mask is the slot's.

    Deviation: those of the image's pixels, which are finer than the embedding grid's that the paper takes.
    """
    chosen, valid = _some_of_each(rearrange(owners, "b f v h w -> b f (v h w)"), slots, _POINTS)
    flat = rearrange(points, "b f v h w c -> b f 1 (v h w) c").expand(-1, -1, slots, -1, -1)
    return orient(
        flat.gather(-2, repeat(chosen, "b f s n -> b f s n 3")),
        valid,
        grid_level=pose.grid_level,
        refinements=pose.refinements,
        tolerance=pose.tolerance,
        min_points=pose.min_pixels,
    )


def _some_of_each(
    owners: Int[Tensor, "batch frame pixel"], slots: int, count: int
) -> tuple[Int[Tensor, "batch frame slot point"], Bool[Tensor, "batch frame slot point"]]:
    """At most `count` pixels of each slot, spread evenly over them in raster order, and which of them there are."""
    mine = owners[:, :, None] == torch.arange(1, slots + 1, device=owners.device)[:, None]
    rank = mine.cumsum(dim=-1) - 1
    total = mine.sum(dim=-1, keepdim=True)
    # Of `total` pixels those are kept at which the running share of `count` passes a whole number.
    kept = mine & ((rank + 1) * count // total.clamp(min=count) > rank * count // total.clamp(min=count))
    best = kept.to(torch.uint8).topk(min(count, kept.shape[-1]), dim=-1, sorted=False)
    return best.indices, best.values.bool()
