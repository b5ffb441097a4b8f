"""Losses of the attention masks (paper, eq. 10 and 11).

The decoder's part is a target without gradient in both, as in the authors' code, which has only the mixture.
`log_likelihood` is that of `obpose.model.losses.observation.colour_log_likelihood`, `log_share` is
log(sigma_hat_k / sigma_max). Deviation: means over the valid rays, not sums over all.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.config import LossConfig
from obpose.model.layers.numerics import log_sum_exp
from obpose.model.losses.observation import COLOUR_STD, mean_over, surface_likelihood
from obpose.model.nerf.along import FieldsAlongRays
from obpose.model.nerf.compose import log_share
from obpose.types import ComponentRays, RayValues


def attention_loss(log_masks: ComponentRays, fields: FieldsAlongRays, config: LossConfig) -> Float[Tensor, ""]:
    """L_att (paper, eq. 10 or 11) in the form of the configuration."""
    likelihood, share, weight = surface_likelihood(fields), log_share(fields.surface.logits), fields.rays.weight
    if config.attention == "l2":
        return attention_l2(log_masks, likelihood, share, weight)
    return attention_mixture(log_masks, likelihood, share, weight, floor=config.attention_floor)


def attention_mixture(
    log_masks: ComponentRays,
    log_likelihood: Float[Tensor, "batch frame component ray channel"],
    log_share: ComponentRays,
    weight: RayValues,
    *,
    floor: float,
) -> Float[Tensor, ""]:
    """Mixture loss (paper, eq. 10): -log sum_k m_k N_k sigma_hat_k - log sum_k m_k sigma_hat_k.

    Deviations: e^floor, the likelihood of an outlier, is added to both sums, so that rays that no mask can explain do
    not pull (the authors' code adds 1e-8). Each colour channel has its own mixture, as in the authors' code.
    """
    # Targets N_k sigma_hat_k per channel, and sigma_hat_k.
    share = log_share.detach()[..., None]
    targets = torch.cat([log_likelihood.detach() + share, share], dim=-1)
    mixtures = log_sum_exp(log_masks[..., None] + targets, dim=2)
    return mean_over(-torch.logaddexp(mixtures, mixtures.new_tensor(floor)).sum(dim=-1), weight)


def attention_warmup(log_prescope: Float[Tensor, "batch frame 2 ray"], fields: FieldsAlongRays) -> Float[Tensor, ""]:
    """Mixture loss during the warm-up, without objects: -log (s_bg N_bg + s_0), summed over channels.

    An addition: the pre-scope learns which points the background does not explain, so that the first seeds are on
    objects. Otherwise they are on the table, no box is around an object, and everything is background for the first
    thousand steps.
    """
    known = log_prescope[:, :, 0, :, None] + surface_likelihood(fields)[:, :, 0].detach()
    return mean_over(-torch.logaddexp(known, log_prescope[:, :, 1, :, None]).sum(dim=-1), fields.rays.weight)


def attention_l2(
    log_masks: ComponentRays,
    log_likelihood: Float[Tensor, "batch frame component ray channel"],
    log_share: ComponentRays,
    weight: RayValues,
) -> Float[Tensor, ""]:
    """L2 loss (paper, eq. 11): sum_k (N_k / N(0|0) - m_k)^2 sigma_hat_k + (m_k - sigma_hat_k)^2.

    N_k is the likelihood of the whole colour, the product over its channels.
    """
    # N_k / N(0|0).
    peak = -1.5 * math.log(2 * math.pi * COLOUR_STD**2)
    match = (log_likelihood.detach().sum(dim=-1) - peak).exp()
    masks, share = log_masks.exp(), log_share.detach().exp()
    errors = (match - masks).square() * share + (masks - share).square()
    return mean_over(errors.sum(dim=2), weight)
