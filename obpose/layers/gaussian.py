"""Diagonal Gaussians: from the numbers of a network, and drawn from."""

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import softplus

from obpose.types import Draw

SMALLEST_STD = 1e-4
"""Keeps the divergence of two Gaussians finite."""

_SHIFT = 2.25
"""Standard deviations start near 0.1 in place of the authors' 0.7: with that much noise a decoder learns to do without
the latent, and the background's collapsed to its prior for good."""


def mean_and_std(
    parameters: Float[Tensor, "*shape twice"],
) -> tuple[Float[Tensor, "*shape latent"], Float[Tensor, "*shape latent"]]:
    """Mean and standard deviation; the first half of the numbers is the mean, the other goes through a softplus."""
    mean, spread = parameters.chunk(2, dim=-1)
    return mean, softplus(spread - _SHIFT) + SMALLEST_STD


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
