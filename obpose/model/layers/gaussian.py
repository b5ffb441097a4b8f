"""Diagonal Gaussians: parameters from a network's output, and samples."""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from obpose.types import Draw

SMALLEST_STD = 1e-4
"""Smallest standard deviation, which keeps divergences finite."""


def mean_and_std(
    parameters: Float[Tensor, "*shape twice"], *, typical_std: float
) -> tuple[Float[Tensor, "*shape latent"], Float[Tensor, "*shape latent"]]:
    """Mean and standard deviation from the output of a network; they are 0 and `typical_std` for an output of 0.

    The first half of the output is the mean, the other half goes through a shifted softplus. The authors' is not
    shifted, so that 0.7 is typical.
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
    """Draw a reparametrised sample, mean + std * noise, or give the mean."""
    if draw == "mean":
        return mean
    noise = torch.randn(mean.shape, generator=generator, device=mean.device, dtype=mean.dtype)
    return mean + std * noise
