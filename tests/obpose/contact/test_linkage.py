import numpy as np
import pytest

from obpose.contact.linkage import average_linkage


def by_hand(count: int, pairs: np.ndarray, attractions: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Average linkage by its definition: all means between all segments, recomputed after each join."""
    segment = np.arange(count)
    while True:
        means = {}
        for one in np.unique(segment):
            for other in np.unique(segment[segment > one]):
                here = segment[pairs]
                edges = ((here == [[one], [other]]).all(axis=0)) | ((here == [[other], [one]]).all(axis=0))
                if edges.any():
                    means[one, other] = np.average(attractions[edges], weights=weights[edges])
        if not means or max(means.values()) <= 0:
            return segment
        one, other = max(means, key=means.__getitem__)
        segment[segment == other] = one


@pytest.mark.parametrize("seed", range(20))
def test_average_linkage_is_as_defined(seed: int):
    rng = np.random.default_rng(seed)
    pairs = np.array([(i, j) for i in range(9) for j in range(i) if rng.random() < 0.5]).T
    attractions = rng.normal(0.2, 1, pairs.shape[1])
    for weights in (None, rng.uniform(0.1, 3, len(attractions))):
        found = average_linkage(9, pairs, attractions, weights)
        expected = by_hand(9, pairs, attractions, np.ones(len(attractions)) if weights is None else weights)
        assert np.array_equal(found[:, None] == found, expected[:, None] == expected)


def test_nodes_without_edges_stay_alone():
    assert average_linkage(3, np.zeros((2, 0), int), np.zeros(0)).tolist() == [0, 1, 2]
