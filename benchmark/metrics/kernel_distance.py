"""Two-sample test: the maximum mean discrepancy (Gretton et al., JMLR 2012)."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Float, Integer


@dataclass(frozen=True)
class KernelDistance:
    """Kernel distance of two samples, with its significance."""

    squared: float
    """Unbiased estimate of MMD^2. For equal distributions it scatters around 0 and may be negative."""
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

    Raises:
        ValueError: a sample has fewer than two members.
    """
    if min(len(one), len(other)) < 2:
        raise ValueError(f"The samples have {len(one)} and {len(other)} members; expected two or more in each.")
    both = np.concatenate([one, other])
    # Kernel of all members, in standard deviations.
    scale = both.std(axis=0)
    kernel = _gaussian((both - both.mean(axis=0)) / np.where(scale > 0, scale, 1.0))
    # Random divisions that keep groups together.
    groups = np.concatenate([one_groups, other_groups + one_groups.max(initial=-1) + 1])
    names, member = np.unique(groups, return_inverse=True)
    of_one = len(np.unique(one_groups))
    drawn = np.stack([_division(len(names), of_one, rng)[member] for _ in range(divisions)])
    # The samples themselves, then the divisions.
    first = np.arange(len(both)) < len(one)
    found, *others = squared_discrepancies(kernel, np.concatenate([first[None], drawn]))
    return KernelDistance(float(found), float((1 + np.sum(np.array(others) >= found)) / (1 + divisions)))


def squared_discrepancies(
    kernel: Float[np.ndarray, "n n"], first: Bool[np.ndarray, "division n"]
) -> Float[np.ndarray, "division"]:
    """The unbiased estimate (their eq. 3) for divisions of all members into the `first` sample and the other.

    Means over pairs of different members within the samples, less twice the mean over pairs across.

    >>> squared_discrepancies(np.ones((4, 4)), np.array([[True, True, False, False]]))
    array([0.])
    """
    of_first = first.astype(np.float64)
    of_other, diagonal = 1 - of_first, np.diag(kernel)
    within = [
        (np.sum((part @ kernel) * part, axis=1) - part @ diagonal) / (part.sum(axis=1) * (part.sum(axis=1) - 1))
        for part in (of_first, of_other)
    ]
    across = np.sum((of_first @ kernel) * of_other, axis=1) / (of_first.sum(axis=1) * of_other.sum(axis=1))
    return within[0] + within[1] - 2 * across


def _gaussian(points: Float[np.ndarray, "n feature"]) -> Float[np.ndarray, "n n"]:
    squares = scipy.spatial.distance.cdist(points, points, "sqeuclidean")
    width = np.median(squares[np.triu_indices(len(points), 1)])
    return np.exp(-squares / (width if width > 0 else 1.0))


def _division(groups: int, of_one: int, rng: np.random.Generator) -> Bool[np.ndarray, "group"]:
    chosen = np.zeros(groups, bool)
    chosen[rng.permutation(groups)[:of_one]] = True
    return chosen
