"""Metrics of other benchmarks: HOTA, IDF1, J&F, AP@50, PQ, F1 and AMI; golden cases hold reference values."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sklearn.metrics import adjusted_mutual_info_score

from benchmark.metrics import OTHER_METRICS, count_clip, other_scores, score
from benchmark.metrics.boundaries import boundary_overlap

few = settings(max_examples=15)
SHAPE = (3, 5, 6)
truths = hnp.arrays(np.uint8, SHAPE, elements=st.integers(0, 3))
predictions = hnp.arrays(np.int64, SHAPE, elements=st.integers(0, 9))
ignored = hnp.arrays(bool, SHAPE)


def others(truth: np.ndarray, prediction: np.ndarray, slot: int = 0, ignore: np.ndarray | None = None) -> np.ndarray:
    scores = score(truth, prediction, slot, ignore)
    return np.array([scores[name] for name in OTHER_METRICS])


@few
@given(truths, predictions, ignored, st.permutations([1, 2, 3]), st.permutations(range(10)), st.integers(0, 9))
def test_names_do_not_matter_but_that_of_the_background(truth, prediction, ignore, objects, slots, background):
    renamed = others(np.array([0, *objects])[truth], np.array(slots)[prediction], slots[background], ignore)
    # HOTA matches each frame by itself, and which of equal matchings it takes is a matter of names.
    free = np.arange(len(OTHER_METRICS)) != OTHER_METRICS.index("hota")
    np.testing.assert_allclose(renamed[free], others(truth, prediction, background, ignore)[free], atol=1e-9)


@few
@given(truths, st.permutations(range(4)))
def test_the_truth_scores_one_under_any_names(truth: np.ndarray, names: list[int]):
    found = others(truth, np.array(names)[truth], names[0])
    np.testing.assert_allclose(found[~np.isnan(found)], 1, atol=1e-9)


@few
@given(truths, predictions)
def test_mutual_information_agrees_with_scikit_learn(truth: np.ndarray, prediction: np.ndarray):
    expected = [adjusted_mutual_info_score(t.ravel(), p.ravel()) for t, p in zip(truth, prediction, strict=True)]
    assert score(truth, prediction)["ami"] == pytest.approx(np.mean(expected), abs=1e-9)


@few
@given(truths, predictions)
def test_scores_of_a_clip_do_not_depend_on_its_batch(truth: np.ndarray, prediction: np.ndarray):
    maps = ((truth, prediction), (prediction, truth.astype(np.int64)), (truth * 0, prediction * 0))
    clips = [count_clip(one[:, None], two[:, None]) for one, two in maps]
    for alone, together in zip((other_scores([clip])[0] for clip in clips), other_scores(clips), strict=True):
        for name, values in alone.items():
            np.testing.assert_allclose(values, together[name], atol=1e-12)


@pytest.mark.parametrize("seed", [5, 15, 31, 39])
def test_hota_is_that_of_its_definition(seed: int):
    """Labels that change their names from frame to frame, so that single frames and the clip prefer other pairs."""
    rng = np.random.default_rng(seed)
    truth = rng.integers(0, 4, (4, 3, 4))
    renamed = np.stack([np.array([0, *rng.permutation([1, 2, 3])])[frame] for frame in truth])
    prediction = np.where(rng.random(truth.shape) < 0.5, renamed, rng.integers(0, 4, truth.shape))
    assert score(truth, prediction)["hota"] == pytest.approx(slow_hota(truth, prediction), abs=1e-9)


def slow_hota(truth: np.ndarray, prediction: np.ndarray) -> float:
    """HOTA of three objects and slots, with all matchings tried (Luiten et al., 2021, sections 4 and 5)."""
    objects, slots = (np.stack([maps == name for name in (1, 2, 3)], axis=1) for maps in (truth, prediction))
    both, any_ = ((op(objects[:, :, None], slots[:, None])).sum(axis=(3, 4)) for op in (np.logical_and, np.logical_or))
    iou = both / np.maximum(any_, 1)
    there, used = objects.any(axis=(2, 3)), slots.any(axis=(2, 3))
    frames = there.sum(axis=0)[:, None] + used.sum(axis=0)
    shared = iou.sum(axis=1, keepdims=True) + iou.sum(axis=2, keepdims=True) - iou
    potential = (iou / np.maximum(shared, 1e-12)).sum(axis=0)
    alignment = potential / np.maximum(frames - potential, 1e-12)
    rows = np.arange(3)
    best = [max(permutations(rows), key=lambda to: np.sum((alignment * one)[rows, to])) for one in iou]
    scores = []
    for alpha in np.arange(0.05, 0.99, 0.05):
        matches = np.zeros((3, 3))
        for one, to in zip(iou, best, strict=True):
            matches[rows, to] += one[rows, to] >= alpha - 1e-12
        detection = matches.sum() / (there.sum() + used.sum() - matches.sum())
        association = np.sum(matches * matches / np.maximum(frames - matches, 1)) / max(matches.sum(), 1)
        scores.append(np.sqrt(detection * association))
    return float(np.mean(scores))


def test_scores_of_single_images_are_ordered_by_frame_and_then_by_view():
    truth = np.zeros((2, 3, 4, 4), int)
    truth[:, :, :2] = 1
    wrong = truth.copy()
    wrong[1, 0] = 0
    assert other_scores([count_clip(truth, wrong, 0)])[0]["f1"].tolist() == [1, 1, 1, 0, 1, 1]


def test_scenes_without_objects_are_undefined():
    empty = np.zeros((2, 4, 4), int)
    found = dict(zip(OTHER_METRICS, others(empty, empty + 1, 0), strict=True))
    assert {name for name, value in found.items() if np.isnan(value)} == {*OTHER_METRICS} - {"ami"}


def test_one_object_all_in_the_background_scores_zero():
    truth = np.zeros((2, 4, 4), int)
    truth[:, :2] = 1
    found = dict(zip(OTHER_METRICS, others(truth, truth * 0), strict=True))
    assert found.pop("ami_fg") == 1  # one object in one segment
    assert [*found.values()] == pytest.approx([0] * len(found))


def test_half_a_clip_under_another_name():
    """Frames are perfect; identity is right in half of them, and association is one half."""
    truth = np.zeros((4, 4, 4), int)
    truth[:, :2, :2] = 1
    prediction = truth.copy()
    prediction[2:] *= 2
    found = score(truth, prediction)
    assert [found[name] for name in ("ap50", "pq", "f1", "idf1")] == [1, 1, 1, 0.5]
    assert (found["hota"], found["j_and_f"]) == pytest.approx((0.5**0.5, 0.5))


def test_no_object_is_matched_to_an_empty_slot_while_there_are_others():
    truth, labels = np.zeros((2, 4, 1, 8, 8), np.uint8)
    truth[0, 0, :2, :2] = labels[:, 0, 6:, 6:] = 1
    assert other_scores([count_clip(truth, labels, 0)])[0]["j_and_f"] == 0


@pytest.mark.parametrize(("found", "expected"), [((), 0.5), ((1,), 0.75)])
def test_an_object_without_a_slot_scores_one_where_it_is_absent(found: tuple[int, ...], expected: float):
    """The second object is visible in two of four frames and never found: it scores 1, 1, 0, 0; TrackEval agrees."""
    truth = np.zeros((4, 4, 4), int)
    truth[:, :2, :2] = 1 if found else 0
    truth[2:, 2:, 2:] = 2
    assert score(truth, np.where(np.isin(truth, found), truth, 0))["j_and_f"] == pytest.approx(expected)


def test_a_false_segment_costs_precision():
    truth = np.zeros((2, 4, 4), int)
    truth[:, :2] = 1
    found = score(truth, np.where(np.arange(4) < 1, truth * 2, truth))
    assert found["pq"] == pytest.approx(0.75 / 1.5)
    assert [found[name] for name in ("f1", "ap50")] == pytest.approx([2 / 3, 1 / 2])


@pytest.mark.parametrize(("size", "tolerance"), [(64, 1), (128, 2)])
def test_boundaries_match_within_the_tolerance(size: int, tolerance: int):
    y, x = np.mgrid[:size, :size]
    for shift, expected in ((tolerance, True), (tolerance + 1, False)):
        one, two = (((y > 10) & (x > 10 + by)).astype(int)[None, None] for by in (0, shift))
        assert (boundary_overlap(one, two, 1, 2)[0, 0, 0, 1] == 1) == expected
