"""Kernel point convolution (Thomas et al. 2019, section 3), rigid, with linear influence."""

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn

from obpose.model.layers.numerics import full_precision

EXTENT = 0.48
"""sigma: extent of a kernel point, in units of the radius of the neighbourhood."""


@torch.no_grad()
@full_precision
def influence(
    offsets: Float[Tensor, "*points 3"], kernel: Float[Tensor, "kernel 3"], *, extent: float = EXTENT
) -> Float[Tensor, "*points kernel"]:
    """Influence of each kernel point at each offset (Thomas et al., eq. 3): max(0, 1 - |y - k| / extent).

    Offsets and kernel points are in units of the radius. There is no gradient. |y|^2 - 2 y k + |k|^2 instead of the
    difference avoids storing three coordinates per pair, and needs full precision.
    """
    offsets, kernel = offsets / extent, kernel / extent
    own = offsets.square() @ offsets.new_ones(3, 1)
    distance = F.linear(offsets, -2 * kernel, kernel.square().sum(-1)).add_(own).clamp_(0, 1).sqrt_()
    return torch.sub(1, distance, out=distance)


class KPConv(nn.Module):
    """Sum over neighbours and kernel points of influence times a linear map of the neighbour's features (eq. 1, 2).

    The influences are an argument, so that layers with the same geometry share them. Those of invalid neighbours are 0.
    """

    def __init__(self, inputs: int, outputs: int, *, kernel: int = 15):
        super().__init__()
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(outputs, inputs * kernel).uniform_(-bound, bound))

    def forward(
        self, features: Float[Tensor, "point neighbour inputs"], influences: Float[Tensor, "point neighbour kernel"]
    ) -> Float[Tensor, "point outputs"]:
        """Map features of the neighbours to features of the points."""
        gathered = torch.bmm(influences.mT, features)
        inputs = features.shape[-1]
        weight = rearrange(self.weight, "outputs (inputs kernel) -> outputs (kernel inputs)", inputs=inputs)
        return F.linear(rearrange(gathered, "point kernel inputs -> point (kernel inputs)"), weight)
