"""Composition of the components' fields into one scene (paper, eq. 8), in log space.

Densities are relative to sigma_max, in 0..1, as losses and voxels need them. The paper's density is sigma_max times
that, and sigma_max occurs only where a rate per metre is meant.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from obpose.model.layers.numerics import log_sum_exp

Logits = Float[Tensor, "*shape component ray"]
Joint = Float[Tensor, "*shape ray"]

OUTSIDE = -30000.0
"""Logit outside a slot's box and of inactive slots: lower than any field's, finite also in half precision."""
SIGMA_MAX = 10.0
"""Density of an opaque point. [code]"""
_SMALL = -4.0
"""Log of the summed softplus below which tanh is computed by its series."""
_EXPONENTIAL = -20.0
"""Logit below which softplus equals the exponential in single precision."""


def log_density(logits: Logits) -> Joint:
    """Log of the joint density over sigma_max (paper, eq. 8): log tanh(sum_k softplus(sigma_k)).

    Finite, with a gradient that does not vanish where the density does, for all logits.
    """
    return _log_tanh_exp(log_sum_exp(_log_softplus(logits), dim=-2))


def log_share(logits: Logits) -> Logits:
    """Log of each component's density over sigma_max (paper, eq. 8): log(tanh(.) softmax_k(sigma_k))."""
    return log_density(logits)[..., None, :] + torch.log_softmax(logits, dim=-2)


def solid_share(logits: Logits, threshold: float) -> Logits:
    """Each component's density over sigma_max for pictures: 0 where the joint density is below the threshold.

    An addition: after minutes of training, objects are surrounded by thin fog. The paper's voxels count as empty below
    sigma_T, too.
    """
    share = log_share(logits).exp()
    return share * (share.sum(dim=-2, keepdim=True) >= threshold)


def air_density(logits: Logits, *, saturation: float | None) -> Joint:
    """Joint density over sigma_max for the air term (paper, eq. 9): tanh(sum_k softplus(sigma_k)).

    An addition: beyond a summed softplus of `saturation`, tanh is continued by its tangent. Its own gradient is exactly
    0 in single precision from about 9 on, so that such dense fog could never clear.
    """
    total = F.softplus(logits).sum(dim=-2)
    if saturation is None:
        return torch.tanh(total)
    # Tangent of tanh at the saturation.
    beyond = F.relu(total - saturation)
    slope = 1 - torch.tanh(total.new_tensor(saturation)) ** 2
    return torch.tanh(total - beyond) + slope * beyond


def mean_colour(logits: Logits, colours: Float[Tensor, "*shape component ray 3"]) -> Float[Tensor, "*shape ray 3"]:
    """Colour of the composed scene (paper, after eq. 8), sum_k sigma_hat_k c_k / sigma_max; black if empty."""
    return (log_share(logits).exp()[..., None] * colours).sum(dim=-3)


def _log_softplus(x: Tensor) -> Tensor:
    return torch.where(x < _EXPONENTIAL, x, F.softplus(x.clamp(min=_EXPONENTIAL)).log())


def _log_tanh_exp(u: Tensor) -> Tensor:
    """Log of tanh(e^u)."""
    low = u.clamp(max=_SMALL)
    high = u.clamp(min=_SMALL).exp()
    # tanh x = x - x^3 / 3 for small x.
    series = low - torch.exp(2 * low) / 3
    direct = torch.log(-torch.expm1(-2 * high)) - torch.log1p(torch.exp(-2 * high))
    return torch.where(u < _SMALL, series, direct)
