import math
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from benchmark.ranking import statistics
from benchmark.ranking.statistics import draw

MANY = 4000


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def whole(scores: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return scores, np.ones_like(scores)


def test_means_pool_frames():
    """One scene with three frames of 1, one with one frame of 0, one without any."""
    scores, weights = np.array([[1.0, 0.0, np.nan]]), np.array([[3.0, 1.0, 0.0]])
    assert statistics.pooled_means(scores, weights).tolist() == [0.75]
    assert math.isnan(statistics.pooled_means(scores, np.zeros((1, 3)))[0])


def test_both_kinds_of_standard_deviation():
    mean, population, sample = statistics.spread(np.array([0.1, 0.2, 0.6]))
    assert mean == pytest.approx(0.3)
    assert population == pytest.approx(np.sqrt((0.04 + 0.01 + 0.09) / 3))
    assert sample == pytest.approx(np.sqrt((0.04 + 0.01 + 0.09) / 2))


def test_one_seed_has_no_sample_deviation():
    assert statistics.spread(np.array([0.5, np.nan]))[:2] == (0.5, 0.0)
    assert math.isnan(statistics.spread(np.array([0.5]))[2])
    assert all(map(math.isnan, statistics.spread(np.array([np.nan]))))


def test_resamples_are_drawn_like_one_matrix_in_little_memory():
    """Published intervals rest on these draws."""
    chosen = np.random.default_rng(0).integers(301, size=(1000, 301))
    tracemalloc.start()
    found = draw(1, 301, np.random.default_rng(0), 1000).scenes
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    np.testing.assert_array_equal(found, [np.bincount(row, minlength=301) for row in chosen])
    assert peak < 1.5 * found.nbytes


def test_weighted_intervals_agree_with_scipy(rng: np.random.Generator):
    scores, weights = rng.beta(4, 2, 60), rng.integers(1, 9, 60).astype(float)
    found = statistics.summarise(scores[None], weights[None], draw(1, 60, rng, MANY))

    def pooled(x: np.ndarray, w: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.sum(x * w, axis=axis) / np.sum(w, axis=axis)

    expected = scipy.stats.bootstrap(
        (scores, weights), pooled, paired=True, n_resamples=MANY, method="percentile", rng=np.random.default_rng(1)
    )
    width = found.high - found.low
    assert found.low == pytest.approx(expected.confidence_interval.low, abs=0.06 * width)
    assert found.high == pytest.approx(expected.confidence_interval.high, abs=0.06 * width)


def test_paired_intervals_agree_with_scipy(rng: np.random.Generator):
    one = rng.beta(4, 2, (3, 70))
    two = np.clip(one[:2] - 0.05 + 0.1 * rng.standard_normal((2, 70)), 0, 1)
    found = statistics.difference(whole(one), whole(two), draw(1, 70, rng, MANY))
    gaps = one.mean(axis=0) - two.mean(axis=0)
    expected = scipy.stats.bootstrap(
        (gaps,), np.mean, n_resamples=MANY, method="percentile", rng=np.random.default_rng(1)
    )
    width = found.high - found.low
    assert found.mean == pytest.approx(gaps.mean())
    assert found.low == pytest.approx(expected.confidence_interval.low, abs=0.06 * width)
    assert found.high == pytest.approx(expected.confidence_interval.high, abs=0.06 * width)
    assert found.resolvable == pytest.approx(2.8 * gaps.std(ddof=1) / np.sqrt(70), rel=0.06)


def test_seeds_widen_the_interval(rng: np.random.Generator):
    scenes = rng.beta(4, 2, (1, 100))
    alike, apart = np.repeat(scenes, 3, axis=0), scenes + np.array([[-0.2], [0.0], [0.2]])
    resamples = draw(3, 100, rng, MANY)
    narrow, wide = (statistics.summarise(*whole(scores), resamples) for scores in (alike, apart))
    assert wide.mean == pytest.approx(narrow.mean)
    assert wide.high - wide.low > 3 * (narrow.high - narrow.low)


def test_seeds_without_randomness_change_nothing(rng: np.random.Generator):
    """The scenes drawn do not depend on the number of seeds."""
    scores = rng.beta(4, 2, (1, 50))
    one = statistics.summarise(*whole(scores), draw(1, 50, np.random.default_rng(5), 500))
    three = statistics.summarise(*whole(np.repeat(scores, 3, axis=0)), draw(3, 50, np.random.default_rng(5), 500))
    assert (one.low, one.high) == pytest.approx((three.low, three.high))


def test_undefined_everywhere_is_nan(rng: np.random.Generator):
    nothing = np.full((2, 4), np.nan), np.zeros((2, 4))
    resamples = draw(2, 4, rng, 50)
    summary = statistics.summarise(*nothing, resamples)
    assert all(map(math.isnan, (summary.mean, summary.std, summary.low, summary.high)))
    assert statistics.difference(nothing, whole(np.ones((1, 4))), resamples).n_scenes == 0


def test_an_undefined_seed_is_left_out(rng: np.random.Generator):
    scores = np.array([[0.5, 0.7], [np.nan, np.nan]])
    summary = statistics.summarise(scores, np.array([[1.0, 1.0], [0.0, 0.0]]), draw(2, 2, rng, 200))
    assert summary.mean == pytest.approx(0.6)
    assert (summary.low, summary.high) == pytest.approx((0.5, 0.7))


def test_equal_models_differ_by_nothing(rng: np.random.Generator):
    scores = whole(rng.beta(4, 2, (3, 40)))
    same = statistics.difference(scores, scores, draw(1, 40, rng, 200))
    assert (same.mean, same.low, same.high, same.p_value, same.win_rate, same.resolvable) == (0, 0, 0, 1, 0.5, 0)


def test_differences_pool_frames(rng: np.random.Generator):
    """The first model leads in a scene with three frames, and is level in one with a single frame."""
    weights = np.array([[3.0, 1.0]])
    one, two = (np.array([[1.0, 0.5]]), weights), (np.array([[0.0, 0.5]]), weights)
    found = statistics.difference(one, two, draw(1, 2, rng, 200))
    assert (found.mean, found.low, found.high) == (0.75, 0, 1)


def test_wins_are_counted_by_scene(rng: np.random.Generator):
    one, two = np.array([[1.0, 1.0, 0.5, 0.0, np.nan]]), np.array([[0.0, 0.9, 0.5, 1.0, 1.0]])
    weights = np.array([[1.0, 1.0, 1.0, 1.0, 0.0]]), np.ones((1, 5))
    found = statistics.difference((one, weights[0]), (two, weights[1]), draw(1, 5, rng, 200))
    assert found.win_rate == 2.5 / 4
    assert found.n_scenes == 4
    assert found.mean == pytest.approx(0.1 / 4)


@pytest.mark.parametrize("offset", [0.0, 1e-6])
def test_scores_that_differ_by_rounding_are_no_win(offset: float, rng: np.random.Generator):
    """Neither by that of means over seeds, nor by that of results with six decimals."""
    one = whole(np.array([[0.1], [0.2], [0.3]]))
    two = whole(one[0][::-1] + offset)
    assert statistics.mean_over_seeds(*one)[0] != statistics.mean_over_seeds(*two)[0]
    assert statistics.difference(one, two, draw(1, 1, rng, 10)).win_rate == 0.5


def test_swapping_the_models_turns_the_sign(rng: np.random.Generator):
    one, two = whole(rng.beta(4, 2, (1, 40))), whole(rng.beta(3, 2, (1, 40)))
    resamples = draw(1, 40, rng, 500)
    there, back = statistics.difference(one, two, resamples), statistics.difference(two, one, resamples)
    assert there.mean == -back.mean
    assert (there.low, there.high) == pytest.approx((-back.high, -back.low))
    assert there.p_value == back.p_value
    assert there.win_rate == pytest.approx(1 - back.win_rate)


def test_pairing_sees_what_unpaired_intervals_hide(rng: np.random.Generator):
    """Scenes differ much more than the models do: a small constant advantage is certain all the same."""
    hard = rng.uniform(0.1, 0.8, (1, 60))
    one, two = whole(hard + 0.02 + 0.01 * rng.standard_normal((1, 60))), whole(hard)
    resamples = draw(1, 60, rng, MANY)
    first, second = (statistics.summarise(*scores, resamples) for scores in (one, two))
    assert first.low < second.high
    found = statistics.difference(one, two, resamples)
    assert found.low > 0
    assert found.p_value < 0.001
    assert found.resolvable < 0.01


def test_one_scene_decides_nothing(rng: np.random.Generator):
    found = statistics.difference(whole(np.array([[1.0]])), whole(np.array([[0.0]])), draw(1, 1, rng, 50))
    assert math.isnan(found.p_value)
    assert math.isnan(found.resolvable)


def test_holm_by_hand():
    corrected = statistics.holm(np.array([0.01, 0.04, 0.03, np.nan, 0.9]))
    assert corrected[[0, 1, 2, 4]] == pytest.approx([0.04, 0.09, 0.09, 0.9])
    assert math.isnan(corrected[3])


@pytest.mark.parametrize(
    ("pairs", "groups"),
    [
        ([], [(0, 1, 2)]),
        ([(0, 1), (0, 2), (1, 2)], [(0,), (1,), (2,)]),
        ([(0, 2)], [(0, 1), (1, 2)]),
        ([(0, 1), (0, 2)], [(0,), (1, 2)]),
    ],
)
def test_tied_groups_by_hand(pairs: list[tuple[int, int]], groups: list[tuple[int, ...]]):
    different = np.zeros((3, 3), bool)
    for pair in pairs:
        different[pair] = True
    assert statistics.tied_groups(different) == groups


@given(hnp.arrays(bool, (6, 6)))
def test_tied_groups_are_all_that_the_tests_leave(different: np.ndarray):
    """Two models share a group if and only if they do not differ, and no group lies in another."""
    different = np.triu(different, 1)
    groups = statistics.tied_groups(different)
    for i in range(6):
        for j in range(i + 1, 6):
            assert any({i, j} <= set(group) for group in groups) is not bool(different[i, j])
    assert not any(set(one) < set(two) for one in groups for two in groups)
    assert set().union(*groups) == set(range(6))


def test_no_models_have_no_groups():
    assert statistics.tied_groups(np.zeros((0, 0), bool)) == []


@given(hnp.arrays(np.float64, st.integers(1, 9), elements=st.sampled_from([0.1, 0.2, 0.3, 0.4])))
def test_ranks_agree_with_scipy(scores: np.ndarray):
    assert statistics.ranks(scores).tolist() == scipy.stats.rankdata(-scores).tolist()


def test_undefined_scores_rank_last():
    assert statistics.ranks(np.array([np.nan, 0.1, -0.2])).tolist() == [3, 1, 2]


Interval = Callable[[np.ndarray, np.random.Generator], tuple[float, float]]


def crossed(scores: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """Ours: one draw of scenes for all seeds."""
    summary = statistics.summarise(*whole(scores), draw(scores.shape[0], scores.shape[1], rng, 500))
    return summary.low, summary.high


def nested(scores: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """Scenes drawn anew for every seed, as if each seed had been scored on scenes of its own."""
    seeds, scenes = scores.shape
    chosen = rng.integers(seeds, size=(500, seeds, 1))
    return statistics.interval(scores[chosen, rng.integers(scenes, size=(500, seeds, scenes))].mean(axis=(1, 2)))


def coverage(n_seeds: int, between: float, within: float, interval: Interval) -> float:
    """Share of 1000 simulated experiments whose interval holds the true score: seeds and scenes are random effects."""
    rng = np.random.default_rng(0)
    held = 0
    for _ in range(1000):
        seeds, scenes = between * rng.standard_normal((n_seeds, 1)), within * rng.standard_normal((1, 60))
        scores = 0.5 + seeds + scenes + 0.02 * rng.standard_normal((n_seeds, 60))
        low, high = interval(scores, rng)
        held += low <= 0.5 <= high
    return held / 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("interval", "n_seeds", "between", "within", "share"),
    [
        (crossed, 1, 0.0, 0.2, 0.95),
        (crossed, 3, 0.0, 0.2, 0.95),
        (crossed, 20, 0.1, 0.2, 0.94),
        (crossed, 3, 0.1, 0.02, 0.75),
        (crossed, 5, 0.1, 0.02, 0.85),
        (crossed, 10, 0.1, 0.02, 0.90),
        (nested, 3, 0.0, 0.2, 0.71),
        (nested, 20, 0.1, 0.2, 0.76),
    ],
)
def test_how_often_intervals_cover_the_truth(
    interval: Interval, n_seeds: int, between: float, within: float, share: float
):
    """As docs/benchmark.md says: few seeds under-cover, and drawing scenes anew for every seed covers less still."""
    assert coverage(n_seeds, between, within, interval) == pytest.approx(share, abs=0.03)


@pytest.mark.slow
def test_what_can_be_resolved_is_found_in_four_of_five():
    """A true difference of the size called resolvable is significant in about 80 % of samples."""
    rng = np.random.default_rng(0)
    spread, n = 0.1, 100
    gap = 2.8 * spread / np.sqrt(n)
    found = 0
    for _ in range(400):
        one, two = gap + spread * rng.standard_normal((1, n)), np.zeros((1, n))
        found += statistics.difference(whole(one), whole(two), draw(1, n, rng, 500)).p_value < 0.05
    assert found / 400 == pytest.approx(0.8, abs=0.06)
