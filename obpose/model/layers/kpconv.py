"""Kernel point convolution (Thomas et al. 2019, section 3), rigid, with linear influence.

Positions of the kernel points: supplementary material, section B.
"""

from functools import lru_cache

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn

from obpose.geometry import full_precision

EXTENT = 0.48
"""sigma: extent of a kernel point, in units of the radius of the neighbourhood."""
KERNEL = 15
"""Number of kernel points."""


@torch.no_grad()
@full_precision
def influence(
    offsets: Float[Tensor, "*points 3"], kernel: Float[Tensor, "kernel 3"]
) -> Float[Tensor, "*points kernel"]:
    """Influence of each kernel point at each offset (Thomas et al., eq. 3): max(0, 1 - |y - k| / sigma).

    Offsets and kernel points are in units of the radius. There is no gradient. |y|^2 - 2 y k + |k|^2 instead of the
    difference avoids storing three coordinates per pair, and needs full precision.
    """
    offsets, kernel = offsets / EXTENT, kernel / EXTENT
    # |y - k|^2 by a matrix product, then 1 - |y - k|, at least 0.
    own = offsets.square() @ offsets.new_ones(3, 1)
    distance = F.linear(offsets, -2 * kernel, kernel.square().sum(-1)).add_(own).clamp_(0, 1).sqrt_()
    return torch.sub(1, distance, out=distance)


class KPConv(nn.Module):
    """Sum over neighbours and kernel points of influence times a linear map of the neighbour's features (eq. 1, 2).

    The influences are an argument, so that layers with the same geometry share them. Those of invalid neighbours are 0.
    """

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(outputs, inputs * KERNEL).uniform_(-bound, bound))

    def forward(
        self, features: Float[Tensor, "point neighbour inputs"], influences: Float[Tensor, "point neighbour kernel"]
    ) -> Float[Tensor, "point outputs"]:
        """Map features of the neighbours to features of the points."""
        # Features at each kernel point, then the kernel's linear maps.
        gathered = torch.bmm(influences.mT, features)
        inputs = features.shape[-1]
        weight = rearrange(self.weight, "outputs (inputs kernel) -> outputs (kernel inputs)", inputs=inputs)
        return F.linear(rearrange(gathered, "point kernel inputs -> point (kernel inputs)"), weight)


SHELL = 0.66
"""Distance of the outer kernel points from the centre, in units of the radius of the neighbourhood."""


def kernel_points(count: int = KERNEL) -> Float[Tensor, "kernel 3"]:
    """Place one point at the origin and the others evenly on a sphere, in units of the radius.

    In Thomas et al. points repel each other and the origin attracts them. With 15 points, one rests at the origin and
    the others at nearly equal distances from it; here the distances are exactly equal.
    """
    return torch.tensor(_disposition(count), dtype=torch.float32)


@lru_cache
def _disposition(count: int) -> list[list[float]]:
    """Minimise the Coulomb energy of points on the sphere by gradient descent."""
    directions = _spiral(count - 1)
    for _ in range(400):
        differences = directions[:, None] - directions
        # Coulomb force of each point on each other; the identity avoids 0 / 0 on the diagonal.
        cubes = (differences.square().sum(-1) + torch.eye(count - 1, dtype=torch.float64)) ** 1.5
        force = (differences / cubes[..., None]).sum(1)
        directions = F.normalize(directions + 0.1 * force, dim=-1)
    return torch.cat([torch.zeros(1, 3, dtype=torch.float64), SHELL * directions]).tolist()


def _spiral(count: int) -> Float[Tensor, "point 3"]:
    """Fibonacci spiral, shifted to break its symmetry, which would lead to a saddle of the energy."""
    place = torch.arange(count, dtype=torch.float64) + 0.5
    height = 1 - 2 * place / count
    angle = place * torch.pi * (3 - 5**0.5)
    across = (1 - height.square()).sqrt()
    spiral = torch.stack([across * angle.cos(), across * angle.sin(), height], dim=-1)
    return F.normalize(spiral + torch.tensor([0.1, 0.2, 0.0], dtype=torch.float64), dim=-1)
