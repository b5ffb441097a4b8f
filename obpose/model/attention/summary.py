"""Summaries of masks: means under them (GENESIS-V2), and the points outside of the largest one."""

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor

from obpose.types import ComponentMasks, GridValid, SlotMasks

_LEAST = 1e-6
"""Smallest divisor, for empty masks."""


def mean_under(
    log_masks: SlotMasks, valid: GridValid, values: Float[Tensor, "batch frame point value"]
) -> Float[Tensor, "batch frame slot value"]:
    """Mean over the valid points, weighted by the mask, which gets a gradient; 0 where there are none."""
    weights = log_masks.exp() * rearrange(valid, "b f point -> b f 1 point")
    return weights @ torch.where(valid[..., None], values, 0.0) / weights.sum(dim=-1, keepdim=True).clamp(min=_LEAST)


def not_largest(log_masks: ComponentMasks) -> Float[Tensor, "batch frame point"]:
    """One minus the mask of a clip's largest component: where objects are, if that is the background."""
    masks = log_masks.exp()
    largest = masks.sum(dim=(1, 3)).argmax(dim=1)
    return (1 - masks[torch.arange(len(masks)), :, largest]).clamp(min=0.0)
