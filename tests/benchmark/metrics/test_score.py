import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sklearn.metrics import adjusted_rand_score

from benchmark.metrics import CLIP_METRICS, METRICS, clip_scores, score

SHAPE = (2, 5, 6)
truths = hnp.arrays(np.uint8, SHAPE, elements=st.integers(0, 3))
predictions = hnp.arrays(np.int64, SHAPE, elements=st.integers(0, 5))


def frame_scores(
    truth: np.ndarray, prediction: np.ndarray, slot: int = 0, ignore: np.ndarray | None = None
) -> dict[str, np.ndarray]:
    """Metrics and counts of the frames of one view."""
    scores = clip_scores(truth[:, None], prediction[:, None], slot, None if ignore is None else ignore[:, None])
    return {name: scores[name] for name in (*METRICS, "objects", "ignored")}


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


@given(truths, predictions)
def test_the_type_of_labels_does_not_matter(truth: np.ndarray, prediction: np.ndarray):
    scores = metrics_of(truth, prediction)
    for kind in (np.uint8, np.uint64):
        np.testing.assert_array_equal(metrics_of(truth.astype(kind), prediction.astype(kind)), scores)


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
        else:
            assert np.isnan([frames["miou_bg"][i], frames["miou_bg_oracle"][i]]).all()


@given(truths, predictions, st.permutations(range(6)), st.integers(0, 5))
def test_names_of_slots_do_not_matter(truth: np.ndarray, prediction: np.ndarray, names: list[int], slot: int):
    """But where two slots suit the background equally well, the oracle takes the first."""
    renamed, new_slot = np.array(names)[prediction], names[slot]
    unique = np.array(
        [n_best_for_background(t, p) == 1 or not np.any(t == 0) for t, p in zip(truth, prediction, strict=True)]
    )
    one, two = metrics_of(truth, prediction, slot), metrics_of(truth, renamed, new_slot)
    free = np.arange(len(METRICS)) != METRICS.index("msc_fg_oracle_bg")
    np.testing.assert_allclose(one[free], two[free], rtol=1e-12)
    np.testing.assert_allclose(one[:, unique], two[:, unique], rtol=1e-12)
    one, two = (score(truth, p, s) for p, s in ((prediction, slot), (renamed, new_slot)))
    for name in (*CLIP_METRICS, "identity_switches"):
        assert one[name] == pytest.approx(two[name], rel=1e-12, nan_ok=True)


def n_best_for_background(truth: np.ndarray, prediction: np.ndarray) -> int:
    ious = [overlap(truth == 0, prediction == slot) for slot in set(prediction.ravel().tolist())]
    return ious.count(max(ious))


def overlap(one: np.ndarray, two: np.ndarray) -> float:
    return np.sum(one & two) / np.sum(one | two)


@given(truths, predictions)
def test_matching_agrees_with_trying_all(truth: np.ndarray, prediction: np.ndarray):
    found = frame_scores(truth, prediction)["miou_fg_hungarian"]
    for i, (t, p) in enumerate(zip(truth, prediction, strict=True)):
        things, slots = sorted(set(t[t > 0].tolist())), [*range(6), 6, 7, 8]
        if not things:
            assert math.isnan(found[i])
            continue
        ious = np.array([[overlap(t == thing, p == slot) for slot in slots] for thing in things])
        rows = np.arange(len(things))
        best = max(ious[rows, list(chosen)].sum() for chosen in itertools.permutations(range(len(slots)), len(things)))
        assert found[i] == pytest.approx(best / len(things))


@given(truths, predictions)
def test_the_oracle_leaves_out_the_slot_that_suits_the_background(truth: np.ndarray, prediction: np.ndarray):
    found = frame_scores(truth, prediction)["msc_fg_oracle_bg"]
    for i, (t, p) in enumerate(zip(truth, prediction, strict=True)):
        slots = sorted(set(p.ravel().tolist()))
        oracle = {max(slots, key=lambda slot: overlap(t == 0, p == slot))} if np.any(t == 0) else set()
        assert found[i] == pytest.approx(slow_covering(t, p, set(slots) - oracle), nan_ok=True)


@given(truths, predictions)
def test_clip_metrics_are_those_of_the_frames_side_by_side(truth: np.ndarray, prediction: np.ndarray):
    found = score(truth, prediction)
    whole = frame_scores(*(np.concatenate(list(maps), axis=1)[None] for maps in (truth, prediction)))
    for clip, frame in (("ari_video", "ari"), ("ari_fg_video", "ari_fg"), ("msc_fg_video", "msc_fg_allslots")):
        assert found[clip] == pytest.approx(whole[frame][0], nan_ok=True)


@given(truths, predictions, st.integers(0, 5))
def test_a_clip_of_one_frame_has_no_time(truth: np.ndarray, prediction: np.ndarray, slot: int):
    scores = clip_scores(truth[None], prediction[None], slot)
    frames = frame_scores(truth, prediction, slot)
    for name, values in frames.items():
        np.testing.assert_array_equal(scores[name], values)
    assert np.all(np.isnan([scores[name] for name in CLIP_METRICS]))
    assert scores["identity_switches"].tolist() == [0, 0]


def test_switches_are_counted_from_when_the_object_was_last_visible():
    """Object 1: slot 1, hidden, slot 2, slot 2. Object 2 comes late. Object 3: half 3, half 4, then 4."""
    truth = np.array([[1, 1, 0, 0, 3, 3], [0, 0, 0, 0, 3, 3], [1, 1, 2, 2, 3, 3], [1, 1, 2, 2, 3, 3]])[:, None]
    slots = np.array([[1, 1, 0, 0, 3, 4], [1, 1, 0, 0, 3, 4], [2, 2, 5, 5, 4, 4], [2, 2, 5, 5, 4, 4]])[:, None]
    assert score(truth, slots)["identity_switches"] == 1


@given(truths, predictions, st.integers(0, 5))
def test_huge_names_count_like_small_ones(truth: np.ndarray, prediction: np.ndarray, slot: int):
    huge = metrics_of(truth * np.int64(10**9), prediction * 10**12 + 7, slot * 10**12 + 7)
    np.testing.assert_array_equal(huge, metrics_of(truth, prediction, slot))


def test_an_object_that_fills_a_frame_leaves_the_oracle_no_background():
    """The first frame is half background; in the second one slot covers an object and another its rest."""
    truth = np.ones((2, 2, 4), int)
    truth[0, 0] = 0
    prediction = truth.copy()
    prediction[1, :, 0] = 2
    frames = frame_scores(truth, prediction)
    assert frames["miou_bg_oracle"][0] == 1
    assert np.isnan(frames["miou_bg_oracle"][1])
    np.testing.assert_array_equal(frames["msc_fg_oracle_bg"], [1, 0.75])
    scores = score(truth, prediction)
    assert (scores["miou_bg_oracle"], scores["msc_fg_oracle_bg"]) == (1, 0.875)
    ignored = frame_scores(truth, prediction, ignore=np.ones(truth.shape, bool))
    assert np.isnan([ignored[name] for name in METRICS]).all()


def test_a_negative_background_slot_is_refused():
    with pytest.raises(ValueError, match="background slot is -1; expected 0 or more"):
        score(np.zeros((1, 2, 2), int), np.zeros((1, 2, 2), int), -1)


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


@pytest.mark.usefixtures("unchecked")
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
def test_wrong_maps_are_refused(truth, prediction, message: str):
    with pytest.raises(ValueError, match=message):
        score(truth, prediction)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("shape", [(2, 3, 3), (2, 1, 3, 4)])
def test_wrong_clips_are_refused(shape: tuple[int, ...]):
    with pytest.raises(ValueError, match="expected one \\(frame, view, height, width\\)"):
        clip_scores(np.zeros((2, 3, 3) if len(shape) == 3 else (2, 1, 3, 3), int), np.zeros(shape, int))
