import numpy as np
import pytest

from benchmark.metrics.kernel_distance import KernelDistance, kernel_distance, squared_discrepancies


def distance(one: np.ndarray, other: np.ndarray, *, group: int = 1, divisions: int = 200) -> KernelDistance:
    groups = (np.arange(len(one)) // group, np.arange(len(other)) // group)
    return kernel_distance(one, other, *groups, divisions=divisions, rng=np.random.default_rng(0))


def normal(seed: int, count: int = 80, mean: float = 0.0) -> np.ndarray:
    return np.random.default_rng(seed).normal(mean, 1, (count, 3))


def test_samples_of_one_distribution_are_not_far_apart():
    found = [distance(normal(2 * seed), normal(2 * seed + 1)) for seed in range(20)]
    assert np.mean([one.squared for one in found]) == pytest.approx(0, abs=0.004)
    assert np.mean([one.p_value <= 0.05 for one in found]) <= 0.15
    assert np.mean([one.p_value for one in found]) > 0.3


def test_others_are_and_the_farther_the_more():
    near, far = (distance(normal(0), normal(1, mean=mean)) for mean in (0.7, 3.0))
    assert near.p_value == far.p_value == 1 / 201
    assert 0.01 < near.squared < far.squared


@pytest.mark.parametrize(("one", "other"), [(1, 5), (5, 1), (0, 5)])
def test_samples_of_fewer_than_two_have_no_distance(one: int, other: int):
    with pytest.raises(ValueError, match=f"have {one} and {other} members; expected two or more"):
        distance(normal(0, one), normal(1, other))


def test_units_make_no_difference():
    scale = np.array([1000.0, 1.0, 1e-3])
    one, other = normal(0), normal(1, mean=0.5)
    assert distance(one * scale, other * scale).squared == pytest.approx(distance(one, other).squared)


def test_members_of_a_group_are_no_independent_witnesses():
    """Twenty copies of four things look different from those of four others, if they are taken for eighty things."""
    one, other = (np.repeat(normal(seed, count=4), 20, axis=0) for seed in (4, 5))
    assert distance(one, other).p_value < 0.02
    assert distance(one, other, group=20).p_value > 0.02


def test_a_feature_that_never_changes_says_nothing():
    one, other = normal(0), normal(1)
    with_constant = [np.column_stack([sample, np.full(len(sample), 7.0)]) for sample in (one, other)]
    assert distance(*with_constant).squared == pytest.approx(distance(one, other).squared)


def test_the_estimate_by_hand():
    kernel = np.array([[1.0, 0.5, 0.1, 0.2], [0.5, 1.0, 0.3, 0.4], [0.1, 0.3, 1.0, 0.6], [0.2, 0.4, 0.6, 1.0]])
    first = np.array([[True, True, False, False], [True, False, True, False]])
    expected = [0.5 + 0.6 - 2 * 0.25, 0.1 + 0.4 - 2 * (0.5 + 0.2 + 0.3 + 0.6) / 4]
    assert squared_discrepancies(kernel, first) == pytest.approx(expected)
