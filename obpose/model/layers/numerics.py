"""Numerically stable functions, where textbook formulas overflow, underflow or lose precision."""

import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor


def log1mexp(x: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Log of 1 - exp(x) for x < 0.

    Exact to rounding from x = -1e-38 down to minus infinity, and so is its gradient, -1 / (exp(-x) - 1).
    """
    return _Log1mExp.apply(x)  # pyright: ignore[reportReturnType]


class _Log1mExp(torch.autograd.Function):
    """Function with its own gradient, because each branch divides 0 by 0 where the other one applies."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return torch.where(x > -math.log(2), torch.log(-torch.expm1(x)), torch.log1p(-torch.exp(x)))

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        (x,) = ctx.saved_tensors
        return -gradient / torch.expm1(-x)


_NOTHING = 80.0
"""Log terms this much smaller than the largest contribute nothing, even in double precision."""


def log_sum_exp(x: Float[Tensor, "*shape"], *, dim: int) -> Tensor:
    """Log of the sum of exp(x) along one axis, bit-identical to `torch.logsumexp`.

    Negligible terms get no gradient; theirs would be less than e^-80. Exponentials that are subnormal in single
    precision take ten times as long on a CPU, and most components are negligible at most points.
    """
    least = x.detach().amax(dim, keepdim=True) - _NOTHING
    return torch.maximum(x, least).logsumexp(dim)


def sharpen(log_masks: Float[Tensor, "*shape"], exponent: float) -> Float[Tensor, "*shape"]:
    """Log of a power of masks, which weights means over points.

    A mask of 0.01 at a thousand points of the table weighs as much as a small object; its cube does not.
    """
    return exponent * log_masks
