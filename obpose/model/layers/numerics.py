"""Small functions that are exact where their textbook formulas overflow, vanish or lose all digits."""

import math
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def all_digits(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Geometry that is not rounded where networks compute in half precision, to a percent of the scene's size."""

    @wraps(function)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        device = next(value.device.type for value in (*args, *kwargs.values()) if isinstance(value, Tensor))
        with torch.autocast(device, enabled=False):
            return function(*args, **kwargs)

    return run


def log1mexp(x: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """log(1 - exp(x)) for x < 0: the log of what is left of a share whose log is x.

    Exact to rounding from x = -1e-38 down to minus infinity, and so is its gradient, -1 / (exp(-x) - 1).
    """
    return _Log1mExp.apply(x)  # pyright: ignore[reportReturnType]


class _Log1mExp(torch.autograd.Function):
    """Own gradient, because that of either branch divides 0 by 0 where the other is meant."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        ctx.save_for_backward(x)
        return torch.where(x > -math.log(2), torch.log(-torch.expm1(x)), torch.log1p(-torch.exp(x)))

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        (x,) = ctx.saved_tensors
        return -gradient / torch.expm1(-x)


_NOTHING = 80.0
"""A term that is so much smaller than the largest, as a logarithm, adds nothing in double precision either."""


def log_sum_exp(x: Float[Tensor, "*shape"], *, dim: int) -> Tensor:
    """Log sum exp(x) along one axis, as `torch.logsumexp`, to the same bits.

    Terms that add nothing get no gradient, where theirs would be less than e^-80. On a CPU exponentials without a
    normal number in single precision take ten times as long, and most components are nothing in most places.
    """
    least = x.detach().amax(dim, keepdim=True) - _NOTHING
    return torch.maximum(x, least).logsumexp(dim)


def sharpen(log_masks: Float[Tensor, "*shape"], power: float) -> Float[Tensor, "*shape"]:
    """Log of a power of masks, by which means over points are weighted.

    A hundredth of a mask at each of a thousand points of the table weighs as much as a small object; its cube does not.
    """
    return power * log_masks
