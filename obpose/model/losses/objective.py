"""Weighted sum of all loss terms (paper, section Training: L = L_obs + L_att + L_others).

The terms of L_obs are collected here, and the regularisers of scope, translation and latents (L_others) defined.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from obpose.config import LossConfig
from obpose.model.losses import observation
from obpose.model.losses.observation import mean_over
from obpose.model.nerf.along import FieldsAlongRays
from obpose.model.nerf.compose import log_share
from obpose.types import Active, GridValid, Latent

SCOPE = 0.25
"""Weight of the scope loss. [paper: 1, with sums over the embedding grid, which has a quarter of the image's points]"""
KL = 1 / 4096
"""Weight of the KL divergence of z_what and z_bg. [paper: 1, with sums over rays]"""
KL_WHERE = 1e-3 * KL
"""Weight of the KL divergence of z_where. [code]"""


def weighted_terms(terms: dict[str, Tensor], config: LossConfig, *, fraction: float) -> dict[str, Tensor]:
    """Add `total`, the weighted sum at this fraction of the budget, to the terms, and detach these."""
    # Weights of L_obs, L_att and L_others.
    weights = {
        "colour": 1.0,
        "surface": 1.0,
        "air": growth(config.air_growth, fraction),
        "attention": config.attention_weight,
        "assignment": 1.0,
        "scope": SCOPE,
        "translation": config.translation,
        "kl_background": KL,
        "kl_what": KL,
        "kl_where": KL_WHERE,
    }
    total = sum((weights[name] * term for name, term in terms.items()), start=terms["surface"].new_zeros(()))
    return {"total": total, **{name: term.detach() for name, term in terms.items()}}


def growth(most: float, fraction: float) -> float:
    """Factor of 1 in the first half of the budget, growing exponentially to `most` at three quarters of it.

    >>> [growth(100.0, fraction) for fraction in (0.0, 0.5, 0.625, 0.75, 1.0)]
    [1.0, 1.0, 10.0, 100.0, 100.0]
    """
    return most ** min(1.0, max(0.0, 4 * fraction - 2))


def observation_terms(fields: FieldsAlongRays, config: LossConfig) -> dict[str, Tensor]:
    """Compute the three terms of L_obs along rays, unweighted (paper, eq. 9)."""
    weight, logits = fields.rays.weight, fields.surface.logits
    return {
        "colour": observation.colour_mixture(log_share(logits), observation.surface_likelihood(fields), weight),
        "surface": observation.surface(logits, weight),
        "air": observation.air(fields.air.logits, fields.inverse_rho, weight, saturation=config.air_saturation),
    }


def remaining_scope(log_scope: Float[Tensor, "batch frame point"], valid: GridValid) -> Float[Tensor, ""]:
    """Remaining scope s_K (paper, eq. 12). Deviation: the mean over valid points, not the sum."""
    return mean_over(log_scope.exp(), valid.to(log_scope.dtype))


def translation(
    predicted: Float[Tensor, "batch frame slot 3"],
    shape: Float[Tensor, "batch frame slot 3"],
    found: Bool[Tensor, "batch frame slot"],
    active: Active,
) -> Float[Tensor, ""]:
    """Squared distance in metres of T_hat and T^shape (paper, eq. 12), summed over slots, mean over frames.

    `shape` is a target without gradient. Inactive slots and shapes that were not found do not count. Deviation: the
    authors' code divides by the batch size twice.
    """
    square = (predicted - shape.detach()).square().sum(dim=-1)
    return torch.where(found & active[:, None], square, 0.0).sum(dim=-1).mean()


def kl(latent: Latent, mask: Bool[Tensor, "..."] | None = None) -> Float[Tensor, ""]:
    """KL(q || p) of a sequence of Gaussians (paper, eq. 12), summed over dimensions and slots, mean over frames.

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
