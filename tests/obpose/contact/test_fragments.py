import numpy as np
import pytest

from obpose.contact.fragments import MOST_FRAGMENTS, OVER_TIME, Evidence, fragments_of, gather
from obpose.contact.grouping import Pairs
from tests.obpose.contact.test_linkage import by_hand


def test_fragments_are_what_no_labelling_divides():
    labels, shared = fragments_of([[np.array([0, 0, 1]), np.array([1])], [np.array([0, 1, 1]), np.array([1])]])
    assert [found.tolist() for found in labels] == [[0, 1, 2], [2]]
    assert shared.tolist() == [[0, 0], [0, 1], [1, 1]]


def test_the_smallest_of_too_many_fragments_join_similar_ones():
    first = np.concatenate([np.repeat(np.arange(MOST_FRAGMENTS), 2), [7]])
    second = np.concatenate([np.zeros(2 * MOST_FRAGMENTS, int), [1]])
    (labels,), shared = fragments_of([[first], [second]])
    assert len(shared) == MOST_FRAGMENTS
    assert labels[-1] == labels[14]


def test_evidence_is_the_mean_over_all_images():
    shared = np.array([[0, 0], [0, 1]])
    images = [Pairs(np.array([[0], [1]]), np.array([value])) for value in (3.0, -2.0)]
    evidence = gather([np.array([0, 1]), np.array([1, 0])], shared, images, bias=0.0)
    # Two pairs of pixels with mean 0.5; the labellings disagree with each other.
    assert evidence.weight[0, 1] * evidence.attraction[0, 1] == 1.0
    assert np.array_equal(evidence.attraction, evidence.attraction.T)
    assert evidence.segments(0.0).tolist() == [0, 0]
    assert evidence.segments(-1.0).tolist() == [0, 1]


@pytest.mark.parametrize("bias", [-1.0, 0.0, 0.5, 1.5, 9.0])
def test_the_bias_is_added_to_affinities_but_never_joins_distant_objects(bias: float):
    """Two fragments that touch, and a third one far from both, which all labellings divide."""
    shared = np.tile(np.arange(3)[:, None], 4)
    images = [Pairs(np.array([[0], [1]]), np.array([3.0]))]
    fragments = [np.arange(3)]
    found, without = (gather(fragments, shared, images, bias=value) for value in (bias, 0.0))
    distant = found.attraction[0, 2] - without.attraction[0, 2]
    assert distant == pytest.approx(min(bias, 0.5))
    near, near_before = (
        each.weight[0, 1] * each.attraction[0, 1] - OVER_TIME * each.attraction[0, 2] for each in (found, without)
    )
    assert near - near_before == pytest.approx(bias)
    assert found.attraction[0, 2] < 0


def test_distant_fragments_weigh_as_much_as_the_pixels_of_the_smaller_one():
    none = Pairs(np.zeros((2, 0), int), np.zeros(0))
    evidence = gather([np.array([0, 0, 0, 1])], np.array([[0], [1]]), [none], bias=0.0)
    np.testing.assert_allclose(evidence.weight, OVER_TIME * np.array([[0, 1], [1, 0]]))


def test_joined_evidence_is_that_of_the_members():
    rng = np.random.default_rng(0)
    weight, attraction = (value + value.T for value in np.triu(rng.uniform(0.5, 2, (2, 6, 6)), 1))
    evidence = Evidence(attraction - 1, weight)
    segments = np.array([0, 0, 1, 1, 2, 2])
    joined = evidence.joined(segments)
    between = np.ix_([0, 1], [2, 3])
    assert np.isclose(joined.weight[0, 1], weight[between].sum())
    assert np.isclose(joined.attraction[0, 1], np.average(attraction[between] - 1, weights=weight[between]))


@pytest.mark.parametrize("seed", range(8))
def test_segments_are_those_of_average_linkage_with_the_weights_of_the_evidence(seed: int):
    rng = np.random.default_rng(seed)
    halves = np.triu(rng.uniform(0.1, 3, (6, 6)), 1), np.triu(rng.normal(-0.2, 1, (6, 6)), 1)
    weight, attraction = (half + half.T for half in halves)
    found = Evidence(attraction, weight).segments(0.3)
    pairs = np.stack(np.triu_indices(6, 1))
    expected = by_hand(6, pairs, attraction[tuple(pairs)] + 0.3, weight[tuple(pairs)])
    assert np.array_equal(found[:, None] == found, expected[:, None] == expected)
