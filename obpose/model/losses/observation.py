"""How well the fields explain what was observed (paper, L_obs). Weighted means over rays, in log space throughout."""

import math
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.model.layers.numerics import log_sum_exp
from obpose.model.nerf.compose import air_density, log_density

_LEAST = 1e-6
"""Weights that sum to less count as this."""

ColourLikelihood = Literal["channel", "joint"]


def log_likelihood(
    colours: Float[Tensor, "batch frame component ray 3"],
    target: Float[Tensor, "batch frame ray 3"],
    *,
    std: float,
    likelihood: ColourLikelihood,
) -> Float[Tensor, "batch frame component ray channel"]:
    """Log N(x | c_k, std^2), for each colour channel (channel = 3), or of the three together (channel = 1)."""
    distance = (target[:, :, None] - colours) / std
    each = -0.5 * distance.square() - math.log(std * math.sqrt(2 * math.pi))
    return each if likelihood == "channel" else each.sum(dim=-1, keepdim=True)


def colour_mixture(
    log_share: Float[Tensor, "batch frame component ray"],
    log_likelihood: Float[Tensor, "batch frame component ray channel"],
    weight: Float[Tensor, "batch frame ray"],
) -> Float[Tensor, ""]:
    """First term of L_obs (paper): -log sum_k N(x | c_k, std^2) sigma_hat_k / sigma_max, summed over channels.

    Deviation: with `channel` likelihoods there is a mixture for each colour channel, as in the authors' code, where the
    paper's is one over the three together. No constant is added inside the logarithm: far colours keep a gradient.
    """
    mixture = log_sum_exp(log_share[..., None] + log_likelihood, dim=2)
    return mean_over(-mixture.sum(dim=-1), weight)


def surface(
    logits: Float[Tensor, "batch frame component ray"],
    weight: Float[Tensor, "batch frame ray"],
    *,
    sigma_max: float,
) -> Float[Tensor, ""]:
    """Second term of L_obs (paper): -log sigma(p_surface)."""
    return mean_over(-log_density(logits) - math.log(sigma_max), weight)


def air(
    logits: Float[Tensor, "batch frame component ray"],
    inverse_rho: Float[Tensor, "batch frame ray"],
    weight: Float[Tensor, "batch frame ray"],
    *,
    sigma_max: float,
    saturation: float | None,
) -> Float[Tensor, ""]:
    """Third term of L_obs (paper): sigma(p_air) / rho_air, with `air_density`'s continuation where it saturates."""
    return mean_over(sigma_max * air_density(logits, saturation=saturation) * inverse_rho, weight)


def mean_over(values: Float[Tensor, "*shape"], weight: Float[Tensor, "*shape"]) -> Float[Tensor, ""]:
    """Weighted mean; 0 where all weights are, whatever the values."""
    return torch.where(weight > 0, values * weight, 0.0).sum() / weight.sum().clamp(min=_LEAST)
