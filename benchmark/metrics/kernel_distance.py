"""Whether two samples come from one distribution: the maximum mean discrepancy (Gretton et al., JMLR 2012)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Integer
from scipy.spatial.distance import cdist


@dataclass(frozen=True)
class KernelDistance:
    """Of two samples."""

    squared: float
    """MMD^2 of the kernel's features without bias: around 0, and below it half of the time, for equal distributions."""
    p_value: float
    """Share of random divisions of all groups into two samples that are as far apart; at least 1 / (1 + divisions)."""


def kernel_distance(
    one: Float[np.ndarray, "n feature"],
    other: Float[np.ndarray, "m feature"],
    one_groups: Integer[np.ndarray, "n"],
    other_groups: Integer[np.ndarray, "m"],
    *,
    divisions: int = 1000,
    rng: np.random.Generator,
) -> KernelDistance:
    """Distance of two samples under a Gaussian kernel as wide as the median distance of any two members.

    Features are measured in standard deviations of both samples together. Members of one group (the objects of a
    scene) depend on each other: the divisions that give the p-value move whole groups.
    """
    both = np.concatenate([one, other])
    scale = both.std(axis=0)
    kernel = _gaussian((both - both.mean(axis=0)) / np.where(scale > 0, scale, 1.0))
    first = np.arange(len(both)) < len(one)
    found = squared_discrepancy(kernel, first)
    groups = np.concatenate([one_groups, other_groups + one_groups.max(initial=-1) + 1])
    names, member = np.unique(groups, return_inverse=True)
    of_one = len(np.unique(one_groups))
    drawn = np.array(
        [squared_discrepancy(kernel, _division(len(names), of_one, rng)[member]) for _ in range(divisions)]
    )
    return KernelDistance(found, float((1 + np.sum(drawn >= found)) / (1 + divisions)))


def squared_discrepancy(kernel: Float[np.ndarray, "n n"], first: np.ndarray) -> float:
    """The unbiased estimate (their eq. 3): means over pairs of different members within samples, less those across.

    >>> squared_discrepancy(np.ones((4, 4)), np.array([True, True, False, False]))
    0.0
    """
    second = ~first
    within = [_mean_of_pairs(kernel[np.ix_(part, part)]) for part in (first, second)]
    return float(sum(within) - 2 * kernel[np.ix_(first, second)].mean())


def _gaussian(points: Float[np.ndarray, "n feature"]) -> Float[np.ndarray, "n n"]:
    squares = cdist(points, points, "sqeuclidean")
    width = np.median(squares[np.triu_indices(len(points), 1)])
    return np.exp(-squares / (width if width > 0 else 1.0))


def _mean_of_pairs(kernel: Float[np.ndarray, "n n"]) -> float:
    count = len(kernel)
    return float((kernel.sum() - np.trace(kernel)) / (count * (count - 1)))


def _division(groups: int, of_one: int, rng: np.random.Generator) -> np.ndarray:
    chosen = np.zeros(groups, bool)
    chosen[rng.permutation(groups)[:of_one]] = True
    return chosen
