import dataclasses

import numpy as np
import pytest

from benchmark.metrics import clip_scores
from benchmark.models.classical.oracles import OracleKSlots, OracleQuarterResolution, OracleSplitBackground, coarsen
from benchmark.models.classical.points import keep_largest
from benchmark.models.interface import Prediction
from tests.worlds.sphere_clips import arbitrary, clip_and_truth


def scores_of(prediction: Prediction, truth: np.ndarray) -> dict[str, np.ndarray]:
    return clip_scores(truth, prediction.labels, prediction.background)


def test_enough_slots_score_one_and_one_less_loses_the_smallest_object():
    clip, truth = clip_and_truth(spheres=4, uses_labels=True)
    enough = scores_of(OracleKSlots(5).segment(clip), truth)
    assert all(np.all(enough[name] == 1) for name in ("ari", "ari_fg", "msc_fg", "miou_bg", "ari_fg_video"))
    fewer = OracleKSlots(4).segment(clip)
    np.testing.assert_allclose(scores_of(fewer, truth)["msc_fg"], 3 / 4)
    smallest = 1 + np.argmin(np.bincount(truth.ravel())[1:])
    np.testing.assert_array_equal(fewer.labels == 0, (truth == 0) | (truth == smallest))


def test_one_slot_is_all_background():
    clip, _ = clip_and_truth(uses_labels=True)
    assert not np.any(OracleKSlots(1).segment(clip).labels)


def test_a_split_background_is_hidden_from_the_metrics_of_objects():
    clip, truth = clip_and_truth(uses_labels=True)
    scores = scores_of(OracleSplitBackground().segment(clip), truth)
    assert np.all(scores["ari_fg"] == 1)
    assert np.all(scores["msc_fg"] == 1)
    assert np.all(scores["miou_bg"] < 0.3)
    assert np.all(scores["ari"] < 0.3)


def test_blocks_take_their_majority():
    labels = np.array([[1, 1, 0, 2, 7], [1, 0, 0, 2, 7], [3, 3, 4, 4, 0]])
    # A tie of 0 and 2 goes to 0; the last row and column are blocks of their own.
    np.testing.assert_array_equal(coarsen(labels, 2), [[1, 1, 0, 0, 7], [1, 1, 0, 0, 7], [3, 3, 4, 4, 0]])


@pytest.mark.parametrize("seed", range(3))
def test_coarse_labels_agree_with_counting_block_by_block(seed: int):
    labels = np.random.default_rng(seed).integers(0, 4, (2, 3, 10, 9))
    coarse = coarsen(labels, 4)
    for image in np.ndindex(2, 3):
        for row in range(0, 10, 4):
            for column in range(0, 9, 4):
                block = np.s_[row : row + 4, column : column + 4]
                assert np.all(coarse[image][block] == np.argmax(np.bincount(labels[image][block].ravel())))


def test_a_quarter_of_the_resolution_loses_nothing_but_detail():
    clip, truth = clip_and_truth(uses_labels=True)
    blocks = truth[..., ::4, ::4].repeat(4, axis=-1).repeat(4, axis=-2)
    assert np.array_equal(OracleQuarterResolution().segment(dataclasses.replace(clip, truth=blocks)).labels, blocks)
    scores = scores_of(OracleQuarterResolution().segment(clip), truth)
    assert 0.2 < np.mean(scores["msc_fg"]) < 0.9
    assert np.all(scores["miou_bg"] > 0.95)


@pytest.mark.parametrize("model", [OracleKSlots(3), OracleQuarterResolution(), OracleSplitBackground()])
def test_without_the_truth_there_is_no_oracle(model: OracleKSlots):
    with pytest.raises(ValueError, match="uses_labels"):
        model.segment(dataclasses.replace(arbitrary(0), truth=None))


def test_the_largest_segments_keep_their_order():
    labels = np.array([0, 5, 5, 5, 2, 3, 3, 3, 3, 9])
    np.testing.assert_array_equal(keep_largest(labels, 2), [0, 2, 2, 2, 0, 1, 1, 1, 1, 0])
    np.testing.assert_array_equal(keep_largest(labels, 9), [0, 3, 3, 3, 1, 2, 2, 2, 2, 4])
    np.testing.assert_array_equal(keep_largest(labels, 0), np.zeros(10))


def test_label_maps_fit_into_bytes():
    assert keep_largest(np.arange(1000)).max() == 255
