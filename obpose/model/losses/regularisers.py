"""Regularisers of scope, translation and latents (paper, L_others)."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from obpose.model.losses.observation import mean_over
from obpose.types import Active, GridValid, Latent


def remaining_scope(log_scope: Float[Tensor, "batch frame point"], valid: GridValid) -> Float[Tensor, ""]:
    """Remaining scope s_K (paper, L_others). Deviation: the mean over valid points, not the sum."""
    return mean_over(log_scope.exp(), valid.to(log_scope.dtype))


def translation(
    predicted: Float[Tensor, "batch frame slot 3"],
    shape: Float[Tensor, "batch frame slot 3"],
    found: Bool[Tensor, "batch frame slot"],
    active: Active,
) -> Float[Tensor, ""]:
    """Squared distance in metres of T_hat and T^shape (paper, L_others), summed over slots, mean over frames.

    `shape` is a target without gradient. Inactive slots and shapes that were not found do not count. Deviation: the
    authors' code divides by the batch size twice.
    """
    square = (predicted - shape.detach()).square().sum(dim=-1)
    return torch.where(found & active[:, None], square, 0.0).sum(dim=-1).mean()


def kl(latent: Latent, mask: Bool[Tensor, "..."] | None = None) -> Float[Tensor, ""]:
    """KL(q || p) of a sequence of Gaussians (paper, L_others), summed over dimensions and slots, mean over frames.

    `mask`, broadcast to batch, frame, slot, excludes inactive slots.
    """
    # Closed form for diagonal Gaussians.
    variance = (latent.std / latent.prior_std).square()
    shift = ((latent.mean - latent.prior_mean) / latent.prior_std).square()
    divergence = 0.5 * (variance + shift - 1 - variance.log()).sum(dim=-1)
    if mask is not None:
        divergence = torch.where(mask, divergence, 0.0)
    batch, frame = divergence.shape[:2]
    return divergence.sum() / (batch * frame)
