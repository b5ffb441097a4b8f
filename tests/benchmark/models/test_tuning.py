import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from benchmark.models.interface import Clip, Prediction
from benchmark.models.model_spec import Builder, ModelSpec
from benchmark.models.tuning import Choice, choose, subsample
from tests.worlds.sphere_clips import clip_and_truth, with_holes

CLIP, TRUTH = clip_and_truth(frames=4)
LOG: list[tuple[Any, ...]] = []


class Right:
    """Right in that many of the first frames it is asked for, all background in the rest."""

    def __init__(self, frames: int, slots: int):
        self.frames, self.slots = frames, slots

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        LOG.append((self.frames, self.slots, len(train), len(val), seed, budget))

    def segment(self, clip: Clip) -> Prediction:
        assert clip.truth is None
        labels = TRUTH.astype(np.int64)
        labels[self.frames :] = 0
        return Prediction(np.where(clip.valid, labels, 99), background_slot=0)


def spec(*frames: int) -> ModelSpec:
    return ModelSpec(Builder(Right), 1, "", grid=tuple({"frames": count} for count in frames))


def choice(*frames: int, clip: Clip = CLIP, truth: np.ndarray = TRUTH) -> Choice:
    LOG.clear()
    return choose(spec(*frames), {"slots": 7}, [CLIP] * 3, [clip], [truth], seed=5, budget=6.0)


def test_the_best_value_is_chosen():
    found = choice(1, 3, 2)
    assert found.options == {"slots": 7, "frames": 3}
    np.testing.assert_allclose(found.scores, [0.25, 0.75, 0.5])


def test_each_value_is_fitted_anew_within_its_share_of_the_budget():
    choice(1, 3)
    assert LOG == [(1, 7, 3, 1, 5, 3.0), (3, 7, 3, 1, 5, 3.0)]


def test_of_equal_values_the_first_is_chosen():
    assert choice(2, 4, 4, 9).options["frames"] == 4
    assert np.argmax(choice(9, 4).scores) == 0
    assert choice(9, 4).options["frames"] == 9


@pytest.mark.parametrize("frames", [(), (2,)])
def test_without_a_choice_nothing_is_run(frames: tuple[int, ...]):
    expected = {"slots": 7} | ({"frames": frames[0]} if frames else {})
    assert choice(*frames) == Choice(expected, ())
    assert LOG == []


def test_pixels_without_depth_do_not_count():
    np.testing.assert_allclose(choice(4, 0, clip=with_holes(CLIP, 0.3)).scores, [1, 0])


def test_without_an_object_in_any_frame_the_default_stays():
    found = choice(2, 4, truth=np.zeros_like(TRUTH))
    assert found.options["frames"] == 2
    assert np.all(np.isnan(found.scores))


def numbered(frames: int) -> tuple[Clip, np.ndarray]:
    """A clip in which everything says which frame it is."""
    clip, truth = clip_and_truth(frames=frames, uses_labels=True)
    number = np.arange(frames)[:, None, None, None]
    depth = np.broadcast_to(number, truth.shape)
    return dataclasses.replace(
        clip, depth=depth.astype(np.float32), truth=depth.astype(np.uint8), valid=depth > 0
    ), depth.copy()


@pytest.mark.parametrize(
    ("clips", "limit", "kept", "frames"),
    [(2, 100, 2, [0, 1, 2, 3, 4, 5]), (2, 6, 2, [1, 3, 5]), (2, 5, 2, [1, 4]), (6, 3, 3, [3]), (0, 5, 0, [])],
)
def test_frames_are_spread_evenly(clips: int, limit: int, kept: int, frames: list[int]):
    clip, truth = numbered(6)
    sample = subsample([clip] * clips, [truth] * clips, limit)
    assert len(sample) == kept
    for thin, labels in sample:
        assert thin.truth is not None
        assert labels[:, 0, 0, 0].tolist() == frames
        assert thin.depth[:, 0, 0, 0].tolist() == frames
        assert thin.truth[:, 0, 0, 0].tolist() == frames
        assert thin.rgb.shape == (*labels.shape, 3)
        np.testing.assert_array_equal(thin.valid, labels > 0)


@pytest.mark.parametrize(("limit", "clips"), [(12, 3), (15, 3), (4, 1), (1, 1), (1000, 5)])
def test_models_that_use_time_are_tuned_on_whole_clips(limit: int, clips: int):
    sample = subsample([CLIP] * 5, [TRUTH] * 5, limit, whole_clips=True)
    assert len(sample) == clips
    assert all(np.array_equal(truth, TRUTH) and len(clip.rgb) == len(TRUTH) for clip, truth in sample)
