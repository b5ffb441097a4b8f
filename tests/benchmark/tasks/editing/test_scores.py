import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.tasks.editing.scores import LARGEST_PSNR, METRICS, depth_error, psnr, score
from tests.benchmark.tasks.editing import oracle

EVERYWHERE = np.ones((1, 1, 2, 2), bool)
BLACK = np.zeros((1, 1, 2, 2, 3))


def test_equal_pictures_have_the_largest_psnr_and_rounding_costs_little():
    assert psnr(BLACK, BLACK, EVERYWHERE) == LARGEST_PSNR
    grey = np.random.default_rng(0).random((1, 1, 64, 64, 3))
    rounded = np.rint(255 * grey) / 255
    assert psnr(grey, rounded, np.ones((1, 1, 64, 64), bool)) == pytest.approx(58.9, abs=0.1)


def test_only_pixels_of_the_region_count():
    shown = BLACK.copy()
    shown[..., 0, 0, :] = 0.1
    corner = np.zeros_like(EVERYWHERE)
    corner[..., 0, 0] = True
    assert psnr(BLACK, shown, corner) == pytest.approx(20)
    assert psnr(BLACK, shown, EVERYWHERE) == pytest.approx(20 + 10 * math.log10(4))
    assert psnr(BLACK, shown, ~corner) == LARGEST_PSNR
    assert math.isnan(psnr(BLACK, shown, ~EVERYWHERE))


def test_depth_errors_are_medians_in_millimetres_where_there_is_depth():
    truth = np.array([[[[1.0, 2.0], [3.0, 0.0]]]])
    shown = truth + np.array([[[[0.001, -0.002], [0.5, 9.0]]]])
    assert depth_error(truth, shown, EVERYWHERE) == pytest.approx(2.0)
    assert math.isnan(depth_error(truth, shown, truth == 0))


def test_the_truth_gets_the_best_scores(edits: Path):
    for pair in oracle.truth_of(edits).pairs:
        scores = score(pair, pair.after)
        assert tuple(scores) == METRICS
        assert scores["psnr_inside"] == scores["psnr_outside"] == LARGEST_PSNR
        assert scores["depth_inside"] == scores["depth_outside"] == 0
        assert scores["ari"] == scores["ari_fg"] == 1


def test_doing_nothing_is_wrong_inside_and_in_shadows_alone(edits: Path):
    remove = oracle.truth_of(edits).pairs[0]
    scores = score(remove, remove.before)
    assert scores["psnr_inside"] < 30 < scores["psnr_outside"]
    assert scores["depth_inside"] > 1 > scores["depth_outside"]
    assert scores["ari"] < 1


def test_names_of_labels_do_not_matter_and_a_label_that_is_missing_does(edits: Path):
    add = oracle.truth_of(edits).pairs[2]
    renamed = replace(add.after, labels=np.where(add.after.labels > 0, 50 - add.after.labels.astype(int), 0))
    assert score(add, renamed)["ari_fg"] == 1
    copy = add.after.labels.max()
    merged = replace(add.after, labels=np.where(add.after.labels == copy, add.object, add.after.labels))
    assert score(add, merged)["ari_fg"] < 1
