import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.tasks.editing.scores import LARGEST_PSNR, METRICS, depth_error, score
from tests.benchmark.tasks.editing import oracle

EVERYWHERE = np.ones((1, 1, 2, 2), bool)


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
