"""Losses of the attention masks (paper, eq. attention_mask and the L2 loss below it).

In both the decoder's part is a target: no gradient goes into it, as in the authors' code, which has only the mixture.
`log_likelihood` is log N(x | c_k, sigma_std) as `obpose.model.losses.observation.log_likelihood` gives it, `log_share`
log(sigma_hat_k / sigma_max). Deviation: means over the valid rays, not sums over all.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.model.layers.numerics import log_sum_exp
from obpose.model.losses.observation import mean_over


def attention_mixture(
    log_masks: Float[Tensor, "batch frame component ray"],
    log_likelihood: Float[Tensor, "batch frame component ray channel"],
    log_share: Float[Tensor, "batch frame component ray"],
    weight: Float[Tensor, "batch frame ray"],
    *,
    floor: float,
) -> Float[Tensor, ""]:
    """Mixture loss (paper, eq. attention_mask): -log sum_k m_k N_k sigma_hat_k - log sum_k m_k sigma_hat_k.

    Deviations: e^floor, the likelihood of an outlier, is added to both sums, so that a ray that no mask can explain
    stops pulling (the authors' code adds 1e-8); of several channels each has a mixture of its own (the authors' code).
    """
    share = log_share.detach()[..., None]
    targets = torch.cat([log_likelihood.detach() + share, share], dim=-1)
    mixtures = log_sum_exp(log_masks[..., None] + targets, dim=2)
    return mean_over(-torch.logaddexp(mixtures, mixtures.new_tensor(floor)).sum(dim=-1), weight)


def attention_warmup(
    log_prescope: Float[Tensor, "batch frame 2 ray"],
    log_likelihood: Float[Tensor, "batch frame background ray channel"],
    weight: Float[Tensor, "batch frame ray"],
    *,
    unknown: float,
) -> Float[Tensor, ""]:
    """The mixture loss while there are no objects yet: -log (s_bg N_bg + s_0 e^unknown), summed over channels.

    An addition: the pre-scope learns which points the background does not explain, so that the first seeds are on
    objects. Without it they are on the table, no box is around an object, and the pre-scope gives up: everything is
    background for the first thousand steps.
    """
    known = log_prescope[:, :, 0, :, None] + log_likelihood[:, :, 0].detach()
    return mean_over(-torch.logaddexp(known, log_prescope[:, :, 1, :, None] + unknown).sum(dim=-1), weight)


def attention_l2(
    log_masks: Float[Tensor, "batch frame component ray"],
    log_likelihood: Float[Tensor, "batch frame component ray channel"],
    log_share: Float[Tensor, "batch frame component ray"],
    weight: Float[Tensor, "batch frame ray"],
    *,
    std: float,
) -> Float[Tensor, ""]:
    """L2 loss (paper, below eq. attention_mask): sum_k (N_k / N(0|0) - m_k)^2 sigma_hat_k + (m_k - sigma_hat_k)^2.

    `std` is sigma_std. N_k is the likelihood of the whole colour also where the channels come apart.
    """
    peak = -1.5 * math.log(2 * math.pi * std**2)
    match = (log_likelihood.detach().sum(dim=-1) - peak).exp()
    masks, share = log_masks.exp(), log_share.detach().exp()
    errors = (match - masks).square() * share + (masks - share).square()
    return mean_over(errors.sum(dim=2), weight)
