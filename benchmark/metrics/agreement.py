"""Agreement of clusterings above chance.

The adjusted Rand index (Hubert and Arabie, 1985) is computed in exact integers, and the adjusted mutual information
(Vinh, Epps and Bailey, 2010) with exact expectations.
"""

import math

import numpy as np
from jaxtyping import Float64, Int64
from scipy.special import gammaln, xlogy


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


NEGLIGIBLE = 1e-15
"""Probability from which on the rest of a distribution is left out."""


def adjusted_mutual_information(tables: Int64[np.ndarray, "frame truth slot"]) -> Float64[np.ndarray, "frame"]:
    """Mutual information of two clusterings above chance, over the mean of their entropies above chance.

    1 for equal clusterings, 0 in the mean for random ones; nan where a frame counts no pixel.

    With S(x) = sum of x log x, this is (S(cells) - E) / ((S(rows) + S(columns)) / 2 - E): E is the mean of S(cells)
    over all tables with the same rows and columns.
    """
    rows, columns, points = tables.sum(axis=2), tables.sum(axis=1), tables.sum(axis=(1, 2))
    frame, row, column = np.nonzero(rows[:, :, None] * columns[:, None, :])
    expected = _mean_of_xlogx(points[frame], rows[frame, row], columns[frame, column])
    chance = np.bincount(frame, expected, minlength=len(tables))
    most = (xlogy(rows, rows).sum(axis=1) + xlogy(columns, columns).sum(axis=1)) / 2 - chance
    above = xlogy(tables, tables).sum(axis=(1, 2)) - chance
    # Nothing is possible above chance only if both clusterings are one cluster, or both are all singletons: then they
    # are equal.
    equal = most <= 1e-12 * np.maximum(chance, 1)
    return np.where(points == 0, np.nan, np.where(equal, 1.0, above / np.where(equal, 1.0, most)))


def _mean_of_xlogx(
    n: Int64[np.ndarray, "cell"], a: Int64[np.ndarray, "cell"], b: Int64[np.ndarray, "cell"]
) -> Float64[np.ndarray, "cell"]:
    """Means of x log x, where x is the overlap of random sets of a and b out of n points (hypergeometric).

    The probabilities of all x follow from that of the mode, by the ratios of neighbours.
    """
    mode = (a + 1) * (b + 1) // (n + 2)
    rest = n - a - b + mode
    factorial = gammaln(np.arange(n.max(initial=0) + 1) + 1.0)
    ways = factorial[[a, b, n - a, n - b]].sum(axis=0) - factorial[[n, mode, a - mode, b - mode, rest]].sum(axis=0)
    table = xlogy(factors := np.arange(n.max(initial=0) + 1.0), factors)
    mean = np.exp(ways) * table[mode]
    for step, above, below in ((1, (a - mode, b - mode), (mode, rest)), (-1, (mode, rest), (a - mode, b - mode))):
        x, probability = mode.copy(), np.exp(ways)
        numerator, denominator = np.array(above, np.float64), np.array(below) + 1.0
        while probability.max(initial=0) > NEGLIGIBLE:
            probability *= numerator[0] * numerator[1] / (denominator[0] * denominator[1])
            x += step
            mean += probability * table.take(x, mode="clip")
            numerator -= 1
            denominator += 1
    return mean
