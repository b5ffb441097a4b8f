"""Likelihood of the observation under the fields (paper, eq. 9): weighted means over rays, in log space."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.model.layers.numerics import log_sum_exp
from obpose.model.nerf.along import FieldsAlongRays
from obpose.model.nerf.compose import SIGMA_MAX, air_density, log_density
from obpose.types import ComponentRays, RayPoints, RayValues

COLOUR_STD = 0.1
"""sigma_std: standard deviation of a component's colour. [code]"""
_LEAST = 1e-6
"""Smallest divisor of weighted means."""


def colour_log_likelihood(
    colours: Float[Tensor, "batch frame component ray 3"], target: RayPoints
) -> Float[Tensor, "batch frame component ray 3"]:
    """Log N(x | c_k, sigma_std^2) of each colour channel; the sum over channels is that of the whole colour."""
    distance = (target[:, :, None] - colours) / COLOUR_STD
    return -0.5 * distance.square() - math.log(COLOUR_STD * math.sqrt(2 * math.pi))


def surface_likelihood(fields: FieldsAlongRays) -> Float[Tensor, "batch frame component ray 3"]:
    """Log-likelihood of the observed colours under each component at the surface."""
    assert fields.surface.colours is not None
    return colour_log_likelihood(fields.surface.colours, fields.rays.colour)


def colour_mixture(
    log_share: ComponentRays, log_likelihood: Float[Tensor, "batch frame component ray channel"], weight: RayValues
) -> Float[Tensor, ""]:
    """First term of L_obs (paper, eq. 9): -log sum_k N(x | c_k, std^2) sigma_hat_k / sigma_max, summed over channels.

    Deviation: one mixture per colour channel, as in the authors' code, instead of one over all three. No constant is
    added inside the logarithm, so that far colours keep a gradient.
    """
    mixture = log_sum_exp(log_share[..., None] + log_likelihood, dim=2)
    return mean_over(-mixture.sum(dim=-1), weight)


def surface(logits: ComponentRays, weight: RayValues) -> Float[Tensor, ""]:
    """Second term of L_obs (paper, eq. 9): -log sigma(p_surface)."""
    return mean_over(-log_density(logits) - math.log(SIGMA_MAX), weight)


def air(
    logits: ComponentRays, inverse_rho: RayValues, weight: RayValues, *, saturation: float | None
) -> Float[Tensor, ""]:
    """Third term of L_obs (paper, eq. 9): sigma(p_air) / rho_air, continued where it saturates (`air_density`)."""
    return mean_over(SIGMA_MAX * air_density(logits, saturation=saturation) * inverse_rho, weight)


def mean_over(values: Float[Tensor, "*shape"], weight: Float[Tensor, "*shape"]) -> Float[Tensor, ""]:
    """Weighted mean; 0 if all weights are 0, even if values are not finite."""
    return torch.where(weight > 0, values * weight, 0.0).sum() / weight.sum().clamp(min=_LEAST)
