import math
from typing import Literal

import numpy as np
import pytest
import torch

from obpose.data.clips import observation_of
from obpose.training.validation import CLIPS, CurvePoint, segment_clip, validate, validation_losses, validation_score
from tests.obpose.toy import QuietToy, ToyClips, ToyModel, toy_config

CPU = torch.device("cpu")


def agreement(truth: np.ndarray, labels: np.ndarray) -> float:
    return float(np.mean((truth > 0) == (labels > 0)))


def losses(model: ToyModel, source: ToyClips, step: int = 5, **changes: object) -> dict[str, float]:
    return validation_losses(model, source, toy_config(**changes).train, step=step, fraction=0.5, device=CPU)


def test_noise_is_the_same_every_time():
    model = ToyModel(toy_config())
    one = losses(model, ToyClips())
    torch.manual_seed(5)
    assert losses(model, ToyClips()) == one
    assert set(one) == {"total", "colour", "spread"}
    assert set(losses(model, ToyClips(), step=1)) == {"total", "colour"}


def test_losses_are_means_over_clips_whatever_the_batch():
    model, source = QuietToy(toy_config()), ToyClips(clips=5)
    reference = losses(model, source, **{"train.batch": 1})
    for batch in (2, 5, 8):
        assert losses(model, source, **{"train.batch": batch}) == pytest.approx(reference, rel=1e-5)


def test_views_apart_are_as_many_scenes():
    model, source = QuietToy(toy_config()), ToyClips(views=3)
    together, apart = (losses(model, source, **{"train.views": views}) for views in ("all", "separate"))
    assert apart == pytest.approx(together, rel=1e-5)


def test_segmentations_of_whole_clips_are_scored():
    model, settings = ToyModel(toy_config()), toy_config().train
    assert validation_score(model, ToyClips(labels=True), settings, agreement, device=CPU) == 1.0
    assert validation_score(model, ToyClips(), settings, agreement, device=CPU) is None


def test_pixels_without_depth_are_not_scored():
    """As in the benchmark: their true labels count as background, which ARI-FG leaves out."""
    seen = []
    source = ToyClips(labels=True)
    whole = source.window(0, 0, source.frames_of_clip)
    window = {**whole, "valid": whole["valid"] & (torch.arange(whole["valid"].shape[-1]) % 2 == 0)}
    source.window = lambda *arguments: window
    model, settings = ToyModel(toy_config()), toy_config().train
    validation_score(model, source, settings, lambda truth, labels: seen.append(truth) or 0.0, device=CPU)
    assert (seen[0][..., 1::2] == 0).all()
    np.testing.assert_array_equal(seen[0][..., ::2], whole["segmentation"][..., ::2])
    assert (whole["segmentation"][..., 1::2] > 0).any()


def test_clips_without_a_score_stay_out_of_the_mean():
    scores = iter([0.5, math.nan, 1.0])
    model, settings = ToyModel(toy_config()), toy_config().train
    source = ToyClips(clips=3, labels=True)
    assert validation_score(model, source, settings, lambda truth, labels: next(scores), device=CPU) == 0.75
    assert validation_score(model, source, settings, lambda truth, labels: math.nan, device=CPU) is None


def test_so_many_clips_are_looked_at():
    seen = []

    class Source(ToyClips):
        def window(self, index: int, start: int, frames: int) -> dict[str, torch.Tensor]:
            seen.append(index)
            return super().window(index, start, frames)

    losses(QuietToy(toy_config()), Source(clips=CLIPS + 4))
    assert seen == list(range(CLIPS))


def test_the_model_trains_on_afterwards():
    class Watched(ToyModel):
        modes: tuple[bool, ...] = ()

        def losses(self, *arguments: object, **options: object) -> dict[str, torch.Tensor]:
            self.modes += (self.training,)
            return super().losses(*arguments, **options)

        def segment(self, observation: object) -> object:
            self.modes += (self.training,)
            return super().segment(observation)

    model = Watched(toy_config())
    source = ToyClips(clips=1, labels=True)
    point = validate(
        model,
        source,
        source,
        toy_config().train,
        step=3,
        fraction=0.5,
        seconds=2.0,
        device=CPU,
        score=agreement,
    )
    assert model.modes == (True, False)
    assert model.training
    assert (point.step, point.seconds, point.ari_fg) == (3, 2.0, 1.0)


def test_a_point_is_a_row_and_plain_values():
    point = CurvePoint(3, 2.0, {"total": 1.5}, 0.25)
    assert point.row() == {"step": 3, "seconds": 2.0, "ari_fg": 0.25, "total": 1.5}
    assert CurvePoint(**point.plain()) == point
    assert "ari_fg" not in CurvePoint(3, 2.0, {"total": 1.5}, None).row()


@pytest.mark.parametrize("views", ["all", "separate"])
def test_labels_are_a_map_of_every_frame_and_view(views: Literal["all", "separate"]):
    window = ToyClips(views=3, labels=True).window(1, 0, 4)
    labels = segment_clip(ToyModel(toy_config()), observation_of([window]), views)
    assert labels.shape == (4, 3, 8, 8)
    assert torch.equal(torch.from_numpy(labels), (window["segmentation"] > 0).long())


def test_views_apart_are_segmented_each_alone():
    seen = []

    class Watched(ToyModel):
        def segment(self, observation):
            seen.append(tuple(observation.depth.shape))
            return super().segment(observation)

    window = observation_of([ToyClips(views=3).window(1, 0, 4)])
    segment_clip(Watched(toy_config()), window, "separate")
    assert seen == [(3, 4, 1, 8, 8)]
