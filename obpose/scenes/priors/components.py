"""Principal components of vectors."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

_ITERATIONS = 4
"""Iterations of the randomised SVD; more make no visible difference."""
_SPARE = 8
"""Extra axes of the randomised SVD, because the last ones are inaccurate."""


class Components(nn.Module):
    """Mean and principal axes of vectors. Before `fit`, the mean and all axes are 0.

    Coefficients are divided by one common scale, such that their mean square over vectors and axes is 1. Axes with more
    variance keep their weight.
    """

    mean: Float[Tensor, " size"]
    axes: Float[Tensor, "size count"]
    """Unit vectors; zero vectors beyond the rank of the data."""
    scale: Float[Tensor, ""]

    def __init__(self, size: int, count: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("axes", torch.zeros(size, count))
        self.register_buffer("scale", torch.ones(()))

    def fit(self, vectors: Float[Tensor, "n size"]) -> None:
        """Compute the mean and the axes of vectors; the result depends only on the vectors and their order."""
        size, count = self.axes.shape
        self.mean.copy_(vectors.mean(dim=0))
        most = min(count + _SPARE, len(vectors), size)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            _, lengths, axes = torch.svd_lowrank(vectors - self.mean, q=most, niter=_ITERATIONS)
        kept = min(count, int((lengths > 1e-5 * vectors.norm()).sum()))
        self.axes.zero_()
        self.axes[:, :kept] = axes[:, :kept]
        self.scale.copy_((lengths[:kept].square().sum() / (len(vectors) * kept)).sqrt() if kept else torch.ones(()))

    def encode(self, vectors: Float[Tensor, "n size"]) -> Float[Tensor, "n count"]:
        """Compute the coefficients along the axes."""
        return (vectors - self.mean) @ self.axes / self.scale

    def decode(self, numbers: Float[Tensor, "n count"]) -> Float[Tensor, "n size"]:
        """Reconstruct vectors from their coefficients."""
        return self.mean + (numbers * self.scale) @ self.axes.T
