import doctest
import importlib
import math

import jaxtyping
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sklearn.metrics import adjusted_rand_score

from benchmark.metrics import METRICS, frame_scores, score

settings.register_profile("metrics", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("metrics")

SHAPE = (2, 5, 6)
truths = hnp.arrays(np.uint8, SHAPE, elements=st.integers(0, 3))
predictions = hnp.arrays(np.int64, SHAPE, elements=st.integers(0, 5))


def metrics_of(truth: np.ndarray, prediction: np.ndarray, slot: int = 0) -> np.ndarray:
    frames = frame_scores(truth, prediction, slot)
    return np.stack([frames[name] for name in METRICS])


def slow_covering(truth: np.ndarray, prediction: np.ndarray, slots: set[int]) -> float:
    """MSC-FG of one frame, from its definition and sets of pixels."""
    best = []
    for thing in set(truth[truth > 0].tolist()):
        ious = [
            np.sum((truth == thing) & (prediction == slot)) / np.sum((truth == thing) | (prediction == slot))
            for slot in slots
        ]
        best.append(max(ious, default=0.0))
    return float(np.mean(best)) if best else math.nan


def test_the_example_in_the_docstring():
    result = doctest.testmod(importlib.import_module("benchmark.metrics.score"), extraglobs={"np": np})
    assert result.attempted > 0
    assert result.failed == 0


@given(truths, predictions)
def test_rand_indices_agree_with_scikit_learn(truth: np.ndarray, prediction: np.ndarray):
    frames = frame_scores(truth, prediction)
    for i in range(len(truth)):
        assert frames["ari"][i] == pytest.approx(adjusted_rand_score(truth[i].ravel(), prediction[i].ravel()))
        foreground = truth[i] > 0
        if np.any(foreground):
            expected = adjusted_rand_score(truth[i][foreground], prediction[i][foreground])
            assert frames["ari_fg"][i] == pytest.approx(expected)
        else:
            assert np.isnan(frames["ari_fg"][i])


@given(truths, predictions, st.integers(0, 7))
def test_overlaps_agree_with_their_definition(truth: np.ndarray, prediction: np.ndarray, slot: int):
    frames = frame_scores(truth, prediction, slot)
    for i in range(len(truth)):
        slots = set(prediction[i].ravel().tolist())
        expected = slow_covering(truth[i], prediction[i], slots - {slot})
        assert frames["msc_fg"][i] == pytest.approx(expected, nan_ok=True)
        expected = slow_covering(truth[i], prediction[i], slots)
        assert frames["msc_fg_allslots"][i] == pytest.approx(expected, nan_ok=True)
        if np.any(truth[i] == 0):
            background = [np.sum((truth[i] == 0) & (prediction[i] == s)) for s in (slot, *slots)]
            unions = [np.sum((truth[i] == 0) | (prediction[i] == s)) for s in (slot, *slots)]
            ious = np.array(background) / unions
            assert frames["miou_bg"][i] == pytest.approx(ious[0])
            assert frames["miou_bg_oracle"][i] == pytest.approx(ious.max())


@given(truths, predictions, st.permutations(range(6)), st.integers(0, 5))
def test_names_of_slots_do_not_matter(truth: np.ndarray, prediction: np.ndarray, names: list[int], slot: int):
    renamed = np.array(names)[prediction]
    np.testing.assert_allclose(metrics_of(truth, renamed, names[slot]), metrics_of(truth, prediction, slot), rtol=1e-12)


@given(truths, predictions, st.permutations([1, 2, 3]))
def test_names_of_objects_do_not_matter(truth: np.ndarray, prediction: np.ndarray, names: list[int]):
    renamed = np.array([0, *names])[truth]
    np.testing.assert_allclose(metrics_of(renamed, prediction), metrics_of(truth, prediction), rtol=1e-12)


@given(truths, predictions, st.integers(0, 5))
def test_huge_names_count_like_small_ones(truth: np.ndarray, prediction: np.ndarray, slot: int):
    huge = metrics_of(truth * np.int64(10**9), prediction * 10**12 + 7, slot * 10**12 + 7)
    np.testing.assert_array_equal(huge, metrics_of(truth, prediction, slot))


@given(truths, predictions, st.randoms(use_true_random=False))
def test_places_of_pixels_do_not_matter(truth: np.ndarray, prediction: np.ndarray, random):
    order = list(range(truth[0].size))
    random.shuffle(order)
    moved = [maps.reshape(2, -1)[:, order].reshape(SHAPE) for maps in (truth, prediction)]
    np.testing.assert_array_equal(metrics_of(*moved), metrics_of(truth, prediction))


@given(truths)
def test_the_truth_itself_scores_one(truth: np.ndarray):
    values = metrics_of(truth, truth)
    oracle = METRICS.index("miou_bg_oracle")
    without_background = ~np.any(truth == 0, axis=(1, 2))
    assert np.all((values == 1) | np.isnan(values) | ((np.arange(6) == oracle)[:, None] & without_background))


@given(truths, predictions, hnp.arrays(bool, SHAPE), st.integers(0, 3), st.integers(0, 5))
def test_ignored_pixels_change_nothing(truth, prediction, ignore, truth_there: int, prediction_there: int):
    other = np.where(ignore, truth_there, truth), np.where(ignore, prediction_there, prediction)
    one, two = (frame_scores(*maps, ignore=ignore) for maps in ((truth, prediction), other))
    for name in (*METRICS, "objects", "ignored"):
        np.testing.assert_array_equal(one[name], two[name])


def test_exact_at_a_hundred_million_points():
    """One frame of 10^8 points: a checkerboard of two objects against itself with one point moved."""
    truth = np.ones((1, 10_000, 10_000), np.uint8)
    truth[:, :, 5_000:] = 2
    prediction = truth.copy()
    prediction[0, 0, 0] = 2
    n, a, b = 10**8, 5 * 10**7, 5 * 10**7
    pairs = lambda count: count * (count - 1) // 2  # noqa: E731
    within, rows, columns = pairs(a - 1) + pairs(b), pairs(a) + pairs(b), pairs(a - 1) + pairs(b + 1)
    numerator = 2 * (within * pairs(n) - rows * columns)
    expected = numerator / ((rows + columns) * pairs(n) - 2 * rows * columns)
    scores = score(truth, prediction)
    assert scores["ari_fg"] == scores["ari"] == expected
    assert scores["msc_fg"] == ((a - 1) / a + b / (b + 1)) / 2


def test_what_a_frame_leaves_undefined_is_counted_and_not_averaged():
    truth = np.array([[[0, 1, 2]], [[0, 0, 0]], [[1, 1, 1]]])
    scores = score(truth, truth)
    assert scores["n_frames"] == 3
    assert scores["n_undefined"] == 2
    assert scores["n_one_object"] == 1
    assert [scores[name] for name in ("ari", "ari_fg", "msc_fg", "miou_bg")] == [1, 1, 1, 1]


def test_undefined_everywhere_is_nan():
    empty = np.zeros((2, 3, 3), int)
    scores = score(empty, empty)
    assert math.isnan(scores["ari_fg"])
    assert scores["n_undefined"] == 2


def test_all_ignored_is_nan():
    empty = np.zeros((1, 2, 2), int)
    scores = score(empty, empty, ignore=np.ones((1, 2, 2), bool))
    assert math.isnan(scores["ari"])
    assert scores["n_ignored"] == 4


@pytest.mark.parametrize(
    ("truth", "prediction", "message"),
    [
        (np.zeros((1, 2, 2), int), np.zeros((1, 2, 3), int), r"shapes \(1, 2, 2\) and \(1, 2, 3\)"),
        (np.zeros((2, 2), int), np.zeros((2, 2), int), "expected one \\(frame, height, width\\)"),
        (np.zeros((1, 2, 2), int), np.zeros((1, 2, 2)), "dtypes int64 and float64; expected integers"),
        (np.zeros((1, 2, 2), int), np.full((1, 2, 2), -1), "must not be negative"),
        (np.zeros((0, 2, 2), int), np.zeros((0, 2, 2), int), "hold no pixel"),
    ],
)
def test_wrong_maps_are_refused(truth, prediction, message: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    with pytest.raises(ValueError, match=message):
        score(truth, prediction)
