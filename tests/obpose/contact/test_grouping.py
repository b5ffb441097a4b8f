import numpy as np
import pytest
from sklearn.metrics import adjusted_rand_score

from obpose.contact.components import OFFSETS, offsets, shifted
from obpose.contact.grouping import MOST_SEGMENTS, foreground_pairs, group


def affinities(truth: np.ndarray, strength: float = 4.0, scale: int = 1) -> np.ndarray:
    logits = np.zeros((OFFSETS, *truth.shape), np.float32)
    for channel, offset in enumerate(offsets(scale)):
        here, there = shifted(truth.shape, offset)
        logits[channel][here] = np.where(truth[here] == truth[there], strength, -strength)
    return logits


def grouped(
    truth: np.ndarray, logits: np.ndarray, *, bias: float = 0.0, embedding: np.ndarray | None = None, **options
):
    """Group the pixels of an image whose foreground is that of `truth`."""
    mask = truth > 0
    vectors = np.zeros((*truth.shape, 2)) if embedding is None else embedding
    found = np.zeros(truth.shape, np.int64)
    found[mask] = 1 + group(foreground_pairs(mask, logits, **options), vectors[mask], bias=bias)
    return found


def three(size: int = 24) -> np.ndarray:
    rows, columns = np.mgrid[:size, :size]
    truth = np.where(columns < size // 3, 1, np.where(rows < size // 2, 2, 3))
    truth[0], truth[-1] = 0, 0
    return truth


@pytest.mark.parametrize("scale", [1, 2])
def test_true_affinities_give_the_objects(scale: int):
    truth = three()
    found = grouped(truth, affinities(truth, scale=scale), scale=scale)
    assert adjusted_rand_score(truth.ravel(), found.ravel()) == 1
    assert np.array_equal(found > 0, truth > 0)
    assert np.unique(found).tolist() == [0, 1, 2, 3]


def test_noise_is_averaged_out():
    truth = three()
    noisy = affinities(truth, 2.0) + np.random.default_rng(0).normal(0, 1, (OFFSETS, *truth.shape))
    found = grouped(truth, noisy)
    assert adjusted_rand_score(truth[truth > 0], found[truth > 0]) > 0.9


def test_a_large_bias_joins_all_that_is_within_reach():
    truth = three()
    assert grouped(truth, affinities(truth), bias=9.0).max() == 1


@pytest.mark.parametrize("size", [1, 3])
def test_the_smallest_of_too_many_segments_join_others(size: int):
    """A row of segments; those at both of its ends have one pixel less than the others."""
    sizes = np.repeat([size, size + 1, size], [20, MOST_SEGMENTS, 20])
    truth = np.repeat(np.arange(1, len(sizes) + 1), sizes)[None]
    found = grouped(truth, affinities(truth))
    large = (truth > 20) & (truth <= 20 + MOST_SEGMENTS)
    assert adjusted_rand_score(found[large], truth[large]) == 1
    assert found.max() == MOST_SEGMENTS


def test_parts_share_no_object_whatever_the_affinities():
    truth = three()
    parts = np.where(truth == 1, 1, 2)
    found = grouped(truth, affinities(0 * truth), components=parts)
    assert adjusted_rand_score(parts[truth > 0], found[truth > 0]) == 1


@pytest.mark.parametrize(("pixels", "objects"), [(2, 3), (3, 4)])
def test_specks_join_the_object_with_the_nearest_embedding(pixels: int, objects: int):
    truth = three()
    truth[5, 4 : 4 + pixels] = 4
    embedding = np.where(truth == 3, 0.0, np.where(truth == 4, 0.2, 5.0))[..., None]
    found = grouped(truth, affinities(truth), embedding=embedding)
    assert found.max() == objects
    assert (np.unique(found[(truth == 4) | (truth == 3)]).size == 1) == (objects == 3)


def test_an_empty_mask_has_no_groups():
    assert not grouped(np.zeros((8, 8), int), np.zeros((OFFSETS, 8, 8))).any()
