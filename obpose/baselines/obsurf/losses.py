"""Losses of ObSuRF with depth: colour at the surface, density there and before it, overlap of slots.

Densities are logits l_k of sigma_k = sigma_max sigmoid(l_k), per unit of length, and stay in log space where possible.
Losses are weighted means over rays.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from obpose.baselines.obsurf.config import ObsurfLossConfig
from obpose.model.losses.observation import mean_over
from obpose.types import RayPoints, RayValues

SIGMA_MAX = 10.0
"""Largest density of a slot, per unit. [code]"""

Logits = Float[Tensor, "batch frame slot ray"]
Weight = RayValues


def log_density(logits: Logits) -> RayValues:
    """Log of the joint density, log sum_k sigma_k."""
    return torch.logsumexp(F.logsigmoid(logits), dim=2) + math.log(SIGMA_MAX)


def log_share(logits: Logits) -> Logits:
    """Log of the slots' weights in colours: log w_k = log sigma_k - log sum_j sigma_j."""
    return torch.log_softmax(F.logsigmoid(logits), dim=2)


def mean_colour(logits: Logits, colours: Float[Tensor, "batch frame slot ray 3"]) -> RayPoints:
    """Colour of the composed scene, sum_k w_k c_k."""
    return (log_share(logits).exp()[..., None] * colours).sum(dim=2)


def colour(composed: RayPoints, target: RayPoints, weight: Weight, *, std: float) -> Float[Tensor, ""]:
    """Colour term -log N(x | sum_k w_k c_k, std^2), summed over channels: a Gaussian instead of ObPose's mixture."""
    squares = 0.5 * ((target - composed) / std).square() + math.log(std * math.sqrt(2 * math.pi))
    return mean_over(squares.sum(dim=-1), weight)


def surface(logits: Logits, weight: Weight) -> Float[Tensor, ""]:
    """Surface term -log sigma(p_surface)."""
    return mean_over(-log_density(logits), weight)


def air(logits: Logits, length: Weight, weight: Weight) -> Float[Tensor, ""]:
    """Air term: estimate of the integral of sigma up to the surface; `length` is 1 / rho_air in units."""
    return mean_over(SIGMA_MAX * torch.sigmoid(logits).sum(dim=2) * length, weight)


def overlap(logits: Logits, weight: Weight) -> Float[Tensor, ""]:
    """Overlap at the surface, sum_k sigma_k - max_k sigma_k: density beside that of the densest slot."""
    densities = SIGMA_MAX * torch.sigmoid(logits)
    return mean_over(densities.sum(dim=2) - densities.amax(dim=2), weight)


def overlap_weight(config: ObsurfLossConfig, fraction: float) -> float:
    """Weight of the overlap at a fraction of the budget: 0, then growing to its final value."""
    grown = (fraction - config.overlap_start) / (config.overlap_full - config.overlap_start)
    return config.overlap * min(max(grown, 0.0), 1.0)
