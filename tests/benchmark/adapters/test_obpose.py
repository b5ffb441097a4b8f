from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.adapters.obpose import ObPoseSegmenter
from benchmark.failed_seeds import has_finite_loss
from benchmark.interface import Clip, Segmenter
from benchmark.registry import find_model
from tests.chosen_scores import run_row
from tests.sphere_clips import clip_and_truth, with_holes

SIZE = (32, 24)


def clips(count: int, **recipe: object) -> list[Clip]:
    return [clip_and_truth(seed, **{"frames": 2, "resolution": SIZE, **recipe})[0] for seed in range(count)]


def fitted(options: dict[str, object], train: Sequence[Clip], *, seed: int = 0) -> ObPoseSegmenter:
    model = find_model("obpose-loc").build({"slots": 4, "steps": 2, **options})
    model.fit(train, train[:1], seed=seed, budget=60.0)
    assert isinstance(model, ObPoseSegmenter)
    return model


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("run") / "own"


@pytest.fixture(scope="module")
def model(folder: Path) -> ObPoseSegmenter:
    return fitted({"folder": folder}, clips(2))


def test_it_is_a_segmenter_of_as_many_slots_as_offered(model: ObPoseSegmenter):
    assert isinstance(model, Segmenter)
    clip = with_holes(clips(1)[0], 0.2)
    found = model.segment(clip)
    assert found.background_slot == 0
    for labels in (found.labels, found.extra["att"]):
        assert labels.shape == clip.depth.shape
        assert not labels[~clip.valid].any()
        assert set(np.unique(labels)) <= set(range(4))


def test_it_says_what_the_rows_need(model: ObPoseSegmenter):
    assert model.parameters > 10_000
    assert model.fit_seconds > 0
    assert model.learning_curve
    assert {"step", "seconds", "loss"} <= set(model.learning_curve[0])
    assert has_finite_loss(run_row(learning_curve=model.learning_curve))
    assert not has_finite_loss(run_row(learning_curve=[{**model.learning_curve[0], "air loss": float("nan")}]))


def test_equal_clips_get_equal_labels_whatever_came_between(model: ObPoseSegmenter):
    first, other = clips(2)
    before = model.segment(first)
    model.segment(other)
    after = model.segment(first)
    np.testing.assert_array_equal(before.labels, after.labels)
    np.testing.assert_array_equal(before.extra["att"], after.extra["att"])


def test_a_run_that_is_made_again_goes_on_in_its_folder(model: ObPoseSegmenter, folder: Path):
    again = fitted({"folder": folder}, clips(2))
    assert again.fit_seconds == model.fit_seconds
    assert again.learning_curve == model.learning_curve
    np.testing.assert_array_equal(again.segment(clips(1)[0]).labels, model.segment(clips(1)[0]).labels)


def test_a_checkpoint_stands_in_for_training(model: ObPoseSegmenter, folder: Path):
    loaded = ObPoseSegmenter("obpose-loc", slots=9, checkpoint=folder)
    loaded.fit([], [], seed=5, budget=0.0)
    assert loaded.parameters == model.parameters
    assert loaded.learning_curve is None
    np.testing.assert_array_equal(loaded.segment(clips(1)[0]).labels, model.segment(clips(1)[0]).labels)


def test_clips_of_other_sizes_lengths_and_views_are_segmented(model: ObPoseSegmenter):
    clip = clips(1, frames=1, views=2, resolution=(48, 36))[0]
    assert model.segment(clip).labels.shape == clip.depth.shape


def test_a_clip_without_any_depth_is_background(model: ObPoseSegmenter):
    found = model.segment(with_holes(clips(1)[0], 1.0))
    assert not found.labels.any()


def test_the_seed_decides(model: ObPoseSegmenter):
    mine = model._model.state_dict()
    others = [fitted({}, clips(2), seed=seed)._model.state_dict() for seed in (0, 1)]
    assert [all(torch.equal(mine[name], other[name]) for name in mine) for other in others] == [True, False]
