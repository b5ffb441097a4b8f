"""Kernels psi of the IC-SBP: how alpha falls with the distance to a seed (Engelcke et al. 2021, GENESIS-V2).

Each gives log alpha, at most `-NEVER_ALL` and at least `-NEVER_NONE`, so that both log alpha and log(1 - alpha) are
finite and have finite gradients at every distance. The published models clamp alpha instead.
"""

import math
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

Kernel = Literal["gaussian", "laplacian", "epanechnikov"]

NEVER_ALL = 1e-6
"""A seed takes no more than exp of minus this of a point, its own included; 1 - 1e-6 in the authors' code."""

NEVER_NONE = 1e3
"""Log alpha is not below minus this: alpha is 0 in every floating-point format, its log is not minus infinity."""

_ROUNDING = 1e-3
"""Distances below this are rounded off to squares in the Laplacian kernel: its tip has no gradient."""

_EPANECHNIKOV_FLOOR = 1e-6
"""Alpha at the end of the support of the Epanechnikov kernel. Beyond it is 0, and no seed would be drawn nearer: there
log alpha goes on falling, like that of the Gaussian."""


def initial_sigma(kernel: Kernel, *, slots: int) -> float:
    """Bandwidth sigma at which alpha is one half at a squared distance of 1/K."""
    if kernel == "gaussian":
        return 1 / (slots * math.log(2))
    if kernel == "laplacian":
        return 1 / (math.sqrt(slots) * math.log(2))
    return 2 / slots


def log_alpha(
    distance: Float[Tensor, "*shape"], log_sigma: Float[Tensor, ""], kernel: Kernel
) -> Float[Tensor, "*shape"]:
    """Log of the kernel at these Euclidean distances: -d^2/sigma, -d/sigma or log(1 - d^2/sigma)."""
    inverse = torch.exp(-log_sigma)
    if kernel == "gaussian":
        exponent = distance.square() * inverse
    elif kernel == "laplacian":
        exponent = ((distance.square() + _ROUNDING**2).sqrt() - _ROUNDING) * inverse
    else:
        left = 1 - distance.square() * inverse
        beyond = (_EPANECHNIKOV_FLOOR - left).clamp(min=0)
        exponent = beyond - torch.log(left.clamp(min=_EPANECHNIKOV_FLOOR))
    return -(exponent + NEVER_ALL).clamp(max=NEVER_NONE)
