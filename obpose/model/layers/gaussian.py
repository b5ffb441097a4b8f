"""Diagonal Gaussians: from the numbers of a network, and drawn from."""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from obpose.types import Draw

SMALLEST_STD = 1e-4
"""Keeps the divergence of two Gaussians finite."""


def mean_and_std(
    parameters: Float[Tensor, "*shape twice"], *, typical_std: float
) -> tuple[Float[Tensor, "*shape latent"], Float[Tensor, "*shape latent"]]:
    """Mean and standard deviation from the output of a network, which for an output of 0 are 0 and `typical_std`.

    The first half of the numbers is the mean, the other half goes through a softplus; the authors' is not shifted, and
    typical of it is 0.7.
    """
    mean, spread = parameters.chunk(2, dim=-1)
    shift = math.log(math.expm1(typical_std))
    return mean, softplus(spread + shift) + SMALLEST_STD


def draw_gaussian(
    mean: Float[Tensor, "*shape latent"],
    std: Float[Tensor, "*shape latent"],
    *,
    draw: Draw,
    generator: torch.Generator | None,
) -> Float[Tensor, "*shape latent"]:
    """A reparametrised sample, mean + std * noise, or the mean."""
    if draw == "mean":
        return mean
    noise = torch.randn(mean.shape, generator=generator, device=mean.device, dtype=mean.dtype)
    return mean + std * noise
