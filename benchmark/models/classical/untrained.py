"""Base of models without training, and a limit on their labels."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Int64

from benchmark.models.interface import LARGEST_LABEL, Clip


@dataclass
class Untrained:
    """Base of segmenters that learn nothing; their fields are their options."""

    seed: int = field(default=0, init=False)
    """Set by `fit`."""

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Keep the seed; there is nothing to learn."""
        self.seed = seed


def keep_largest(labels: Int64[np.ndarray, "*pixel"], count: int = LARGEST_LABEL) -> Int64[np.ndarray, "*pixel"]:
    """Relabel the `count` largest segments from 1, in their old order; the others join segment 0."""
    sizes = np.bincount(labels.ravel(), minlength=1)
    sizes[0] = 0
    largest = np.argsort(-sizes, kind="stable")[: min(count, np.count_nonzero(sizes))]
    new = np.zeros(len(sizes), np.int64)
    new[np.sort(largest)] = np.arange(1, len(largest) + 1)
    return new[labels]
