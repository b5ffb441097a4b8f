from pathlib import Path

import numpy as np
import pytest

from benchmark.tasks.editing.answers import answers_of, match, reference_answers
from benchmark.tasks.editing.scores import LARGEST_PSNR
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
    for pair, answer in reference_answers(oracle.truth_of(edits).pairs):
        if answer.name == "true-pixels":
            assert answer.scores["psnr_inside"] == LARGEST_PSNR
            assert answer.scores["ari"] == 1
            assert not pair.shadow.any() or answer.scores["psnr_shadow"] < 40
