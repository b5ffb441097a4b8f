"""Positions of the kernel points of a KPConv (Thomas et al. 2019, supplementary material, section B)."""

from functools import lru_cache

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

SHELL = 0.66
"""Distance of the outer kernel points from the centre, in units of the radius of the neighbourhood."""


def kernel_points(count: int = 15) -> Float[Tensor, "kernel 3"]:
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
