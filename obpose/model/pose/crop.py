"""Input of an object encoder: the slot's own points in its box, in its frame, with masked features."""

from dataclasses import dataclass
from typing import Literal

import torch
from einops import rearrange, repeat
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.geometry import to_box
from obpose.types import Boxes, GridPoints, GridValid, SlotMasks


@dataclass(frozen=True, eq=False)
class BoxSamples:
    """Points of each box, in no particular order."""

    points: Float[Tensor, "batch frame slot sample 3"]
    """Object frame, in -1..1; 0 where not valid."""
    features: Float[Tensor, "batch frame slot sample feature"]
    """Features times the slot's mask; 0 where not valid."""
    mask: Float[Tensor, "batch frame slot sample"]
    """The slot's mask; 0 where not valid."""
    valid: Bool[Tensor, "batch frame slot sample"]
    """Whether there is a point."""


def gather_box(
    points: GridPoints,
    valid: GridValid,
    features: Float[Tensor, "batch frame point feature"],
    log_masks: SlotMasks,
    boxes: Boxes,
    *,
    samples: int,
    whose: Literal["own", "all"],
) -> BoxSamples:
    """Gather the slot's own points in each box; of more than `samples`, those with the largest masks.

    Features are zeta_f * no_grad(m) (paper, section Object Location and Orientation Conditioned Encoding). A slot's own
    points are those at which no other slot has a larger mask. The paper also excludes points at which the background's
    is larger, which here are kept as the support of the object. The authors' code takes `all` points in the box, and
    fields then claim the neighbours. Boxes and positions get no gradient.
    """
    with torch.no_grad():
        # Own points in the box (paper, eq. 6).
        each = points[:, :, None].expand(-1, -1, boxes.center.shape[2], -1, -1)
        in_box = to_box(each, boxes.center, boxes.rotation, boxes.size)
        inside = (in_box.abs().amax(dim=-1) <= 1) & valid[:, :, None]
        if whose == "own":
            inside &= log_masks >= log_masks.amax(dim=2, keepdim=True)
        # Points with the largest masks.
        count = min(samples, log_masks.shape[-1])
        best = log_masks.masked_fill(~inside, -torch.inf).topk(count, dim=-1, sorted=False)
        index, chosen = best.indices, best.values > -torch.inf
        mask = log_masks.gather(-1, index).exp().masked_fill(~chosen, 0)
        near = in_box.gather(-2, repeat(index, "b f s n -> b f s n 3")) * chosen[..., None]
    return BoxSamples(near, _pick(features, index) * mask[..., None], mask, chosen)


def _pick(
    features: Float[Tensor, "batch frame point feature"], index: Int[Tensor, "batch frame slot sample"]
) -> Float[Tensor, "batch frame slot sample feature"]:
    """Select rows of a flat table, which is differentiated fast."""
    batch, frame, point, _ = features.shape
    first = torch.arange(batch * frame, device=features.device) * point
    rows = index + rearrange(first, "(b f) -> b f 1 1", b=batch)
    table = rearrange(features, "b f point feature -> (b f point) feature")
    return table.index_select(0, rows.flatten()).unflatten(0, index.shape)
