import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.tasks.editing.answers import (
    LARGEST_PSNR,
    METRICS,
    answers_of,
    depth_error,
    match,
    reference_answers,
    score,
)
from datagen.schema import EDITS
from tests.benchmark.tasks.editing import oracle

TRUTH = np.array([[[[0, 1, 1, 1], [0, 0, 2, 2]]]])


def test_the_label_with_more_than_half_of_the_union_is_the_object_s():
    labels = np.array([[[[0, 7, 7, 0], [0, 0, 3, 3]]]])
    assert match(TRUTH, labels, 1).label == 7
    assert match(TRUTH, labels, 1).iou == pytest.approx(2 / 3)
    assert match(TRUTH, labels, 2).label == 3


@pytest.mark.parametrize("row", [[0, 7, 0, 0], [7, 7, 8, 0], [0, 0, 0, 0]])
def test_an_object_that_is_split_swallowed_or_missed_has_no_label(row: list[int]):
    assert match(TRUTH, np.array([[[row, [7, 7, 0, 0]]]]), 1).label is None


def test_the_background_is_never_an_object():
    found = match(np.ones((1, 1, 2, 2), int), np.zeros((1, 1, 2, 2), int), 1)
    assert (found.label, found.iou) == (None, 0.0)


def test_only_views_that_the_model_looked_at_are_compared():
    two = np.concatenate([TRUTH, 1 - TRUTH.clip(max=1)], axis=1)
    assert match(two, TRUTH, 1).label == 1


def test_an_oracle_is_asked_for_the_right_objects_and_gets_the_best_scores(edits: Path):
    truth = oracle.truth_of(edits)
    scene = oracle.Oracle(truth)
    answers = list(answers_of(scene, truth))
    assert scene.asked == [(pair.kind, pair.object + 10) for pair in truth.pairs]
    assert [(pair.kind, answer.name) for pair, answer in answers] == [
        (kind, name) for kind in EDITS for name in ("edit", "reconstruction")
    ]
    for _, answer in answers:
        assert answer.scores["psnr_inside"] == answer.scores["psnr_outside"] == LARGEST_PSNR
        assert answer.scores["ari"] == 1
        assert answer.match is None or answer.match.iou == 1


def test_what_is_not_found_is_not_edited_and_is_scored_all_the_same(edits: Path):
    truth = oracle.truth_of(edits)
    scene = oracle.Oracle(truth, blind=True)
    answers = {(pair.kind, answer.name): answer for pair, answer in answers_of(scene, truth)}
    assert scene.asked == []
    failed = answers["remove", "edit"]
    assert failed.match is not None
    assert failed.match.label is None
    nothing = {pair.kind: answer for pair, answer in reference_answers(truth.pairs) if answer.name == "no-edit"}
    assert failed.scores == nothing["remove"].scores


def test_true_pixels_are_wrong_in_shadows_alone(edits: Path):
    answers = [found for found in reference_answers(oracle.truth_of(edits).pairs) if found[1].name == "true-pixels"]
    assert any(pair.shadow.any() for pair, _ in answers)
    for pair, answer in answers:
        assert answer.scores["psnr_inside"] == LARGEST_PSNR
        assert answer.scores["ari"] == 1
        assert not pair.shadow.any() or answer.scores["psnr_shadow"] < 40


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
