"""What lies under a mask, as one code: the mean of features and positions (GENESIS-V2; the paper's IC-SBP ablation)."""

import torch
from einops import rearrange
from jaxtyping import Bool, Float
from torch import Tensor

_LITTLE = 1e-6
"""Masks that sum to less than this count as this."""


def mean_under(
    log_masks: Float[Tensor, "batch frame slot point"],
    valid: Bool[Tensor, "batch frame point"],
    values: Float[Tensor, "batch frame point value"],
) -> Float[Tensor, "batch frame slot value"]:
    """Mean over the valid points, weighted by the mask, which has a gradient; 0 where there are none."""
    weights = log_masks.exp() * rearrange(valid, "b f point -> b f 1 point")
    return weights @ torch.where(valid[..., None], values, 0.0) / weights.sum(dim=-1, keepdim=True).clamp(min=_LITTLE)
