"""Principal components: a few numbers for a vector of many, where vectors differ in a few ways."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

_ITERATIONS = 4
"""Of the randomised search for axes; more change them by less than noise does."""
_SPARE = 8
"""Axes that are searched for beyond those that are kept, as the last ones are found badly."""


class Components(nn.Module):
    """Mean and principal axes of vectors; before `fit` there is no axis, and all vectors are the mean, which is 0.

    Numbers along the axes are divided by one scale, so that their mean square over vectors and axes is 1: axes along
    which vectors differ more keep their weight.
    """

    mean: Float[Tensor, " size"]
    axes: Float[Tensor, "size count"]
    """Of length 1, or 0 where vectors did not differ in so many ways."""
    scale: Float[Tensor, ""]

    def __init__(self, size: int, count: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("axes", torch.zeros(size, count))
        self.register_buffer("scale", torch.ones(()))

    def fit(self, vectors: Float[Tensor, "n size"]) -> None:
        """Take the mean and the axes of these; what comes out depends on them and their order alone."""
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
        """Numbers along the axes."""
        return (vectors - self.mean) @ self.axes / self.scale

    def decode(self, numbers: Float[Tensor, "n count"]) -> Float[Tensor, "n size"]:
        """The vectors that have these numbers, and nothing across all axes."""
        return self.mean + (numbers * self.scale) @ self.axes.T
