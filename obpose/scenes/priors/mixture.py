"""Mixtures of normal distributions, fitted to latents."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

if TYPE_CHECKING:  # it takes a second to import, which only fitting needs
    from sklearn.mixture import GaussianMixture

MOST_PARTS = 64
_HELD = 5
"""Interval of held-out values: every 5th is held out to choose the number of Gaussians."""
_LEAST_VALUES = 16
"""Least number of values for each Gaussian."""
_LEAST_VARIANCE = 1e-3
"""Variance added to each Gaussian along all axes, as a share of the mean variance of the values."""
_LARGEST_VALUE = 1e6
_ROUNDING = 1e-3
"""Largest difference of the sum of mixture weights from 1."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """A mixture of normal distributions."""

    weights: Float[Tensor, "part"]
    """Mixture weights, which sum to one."""
    means: Float[Tensor, "part latent"]
    factors: Float[Tensor, "part latent latent"]
    """Factors of the covariances: that of a part is factor factor^T."""

    def draw(self, count: int, generator: torch.Generator) -> Float[Tensor, "count latent"]:
        """Draw independent samples."""
        if count == 0:
            return self.means[:0]
        part = self.weights.multinomial(count, replacement=True, generator=generator)
        noise = torch.randn(count, self.means.shape[1], generator=generator)
        return self.means[part] + torch.einsum("nij,nj->ni", self.factors[part], noise)

    def fault(self) -> str | None:
        """Describe the first invalid value; None if all are valid."""
        if not 1 <= len(self.weights) <= MOST_PARTS:
            return f"a mixture has {len(self.weights)} parts, expected 1 to {MOST_PARTS}"
        if not bool((self.weights >= 0).all()) or abs(float(self.weights.sum()) - 1) > _ROUNDING:
            return "the weights of a mixture do not sum to one"
        if max(float(part.abs().max()) for part in (self.means, self.factors)) > _LARGEST_VALUE:
            return f"a mixture has values above {_LARGEST_VALUE:g}"
        return None


def normal(mean: Float[Tensor, "latent"], std: Float[Tensor, "latent"]) -> Mixture:
    """Give a single normal distribution with independent values."""
    return Mixture(torch.ones(1), mean[None], torch.diag(std)[None])


def fit_mixture(values: Float[Tensor, "n latent"]) -> Mixture:
    """Fit 1, 2, 4 ... Gaussians; the number doubles while the likelihood of held-out values increases.

    A few values give a single Gaussian with their mean and covariance. The result depends only on the values and their
    order.
    """
    held = torch.arange(len(values)) % _HELD == 0
    count, tried, best = 1, 1, -torch.inf
    while tried <= MOST_PARTS and tried * _LEAST_VALUES <= (~held).sum():
        score = _expectation_maximisation(values[~held], tried).score(values[held].numpy())
        if score <= best:
            break
        count, best, tried = tried, score, 2 * tried
    if count == 1:
        return _gaussian(values)
    found = _expectation_maximisation(values, count)
    parts = found.weights_, found.means_, np.linalg.cholesky(np.asarray(found.covariances_))
    return Mixture(*(torch.from_numpy(part).float() for part in parts))


def _expectation_maximisation(values: Float[Tensor, "n latent"], count: int) -> "GaussianMixture":
    from sklearn.mixture import GaussianMixture

    least = _LEAST_VARIANCE * float(values.var(dim=0).mean())
    return GaussianMixture(count, reg_covar=least, max_iter=200, random_state=0).fit(values.double().numpy())


def _gaussian(values: Float[Tensor, "n latent"]) -> Mixture:
    """Fit one Gaussian by principal axes, because there may be fewer values than dimensions."""
    mean = values.mean(dim=0)
    _, spread, axes = torch.linalg.svd(values - mean, full_matrices=False)
    factor = torch.zeros(values.shape[1], values.shape[1])
    factor[:, : len(spread)] = axes.T * (spread / (len(values) - 1) ** 0.5)
    return Mixture(torch.ones(1), mean[None], factor[None])
