"""The adjusted Rand index (Hubert and Arabie, 1985) in exact integers."""

import math

import numpy as np
from jaxtyping import Float64, Int64


def adjusted_rand(tables: Int64[np.ndarray, "frame truth slot"]) -> Float64[np.ndarray, "frame"]:
    """Agreement of two clusterings above chance: 1 for equal ones, 0 in the mean for random ones, -0.5 at worst.

    nan where a frame counts no pixel.
    """
    within = _pairs(tables).sum(axis=(1, 2))
    rows, columns = _pairs(tables.sum(axis=2)).sum(axis=1), _pairs(tables.sum(axis=1)).sum(axis=1)
    points = tables.sum(axis=(1, 2))
    return np.array(
        [_index(*map(int, counts)) for counts in zip(points, within, rows, columns, strict=True)], np.float64
    )


def _pairs(counts: np.ndarray) -> np.ndarray:
    return counts * (counts - 1) // 2


def _index(points: int, within: int, rows: int, columns: int) -> float:
    """The index from pairs of points: `within` one cell, one row, one column of the table.

    Products of pair counts pass 2^63 at 75,000 points, so these are Python's integers: nothing overflows or cancels.
    """
    if points == 0:
        return math.nan
    total = points * (points - 1) // 2
    denominator = (rows + columns) * total - 2 * rows * columns
    # Zero only if both clusterings are one cluster, or both are all singletons: then they are equal.
    return 1.0 if denominator == 0 else 2 * (within * total - rows * columns) / denominator
