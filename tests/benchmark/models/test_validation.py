from pathlib import Path

import numpy as np
import pytest

from benchmark.csv_files import load_curve
from benchmark.models.interface import Clip, Prediction
from benchmark.models.validation import CLIPS, FRAMES, ValidationScorer
from tests.worlds.sphere_clips import clip_and_truth


@pytest.fixture(scope="module")
def scenes() -> list[tuple[Clip, np.ndarray]]:
    return [clip_and_truth(seed, frames=2, resolution=(32, 24)) for seed in range(2)]


def watch(scenes: list[tuple[Clip, np.ndarray]], folder: Path) -> ValidationScorer:
    clips, truths = zip(*scenes, strict=True)
    return ValidationScorer(clips, truths, folder / "watched" / "run.csv")


def right(scenes: list[tuple[Clip, np.ndarray]]):
    """Segments as the truth is."""
    known = {clip.rgb.tobytes(): truth for clip, truth in scenes}
    return lambda clip: Prediction(known[clip.rgb.tobytes()].astype(np.int64), 0)


def wrong(clip: Clip) -> Prediction:
    return Prediction(np.zeros(clip.depth.shape, np.int64), 0)


def test_what_a_model_segments_is_scored_and_the_model_is_told_nothing(scenes, tmp_path: Path):
    seen = watch(scenes, tmp_path)
    assert seen(wrong, step=1, seconds=0.5) is None
    seen(right(scenes), step=4, seconds=2.0)
    first, second = load_curve(seen.path) or []
    assert (first["step"], first["seconds"], first["msc_fg"]) == (1.0, 0.5, 0.0)
    assert second == {"step": 4.0, "seconds": 2.0, "ari_fg": 1.0, "msc_fg": 1.0}


def test_scores_stand_in_the_learning_curve_at_their_steps(scenes, tmp_path: Path):
    seen = watch(scenes, tmp_path)
    seen(right(scenes), step=4, seconds=2.0)
    curve = seen.added_to([{"step": 2.0, "loss": 9.0}, {"step": 4.0, "seconds": 2.5, "loss": 8.0}, {"loss": 7.0}])
    assert curve == [
        {"step": 2.0, "loss": 9.0},
        {"step": 4.0, "seconds": 2.5, "ari_fg": 1.0, "msc_fg": 1.0, "loss": 8.0},
        {"loss": 7.0},
    ]
    assert watch(scenes, tmp_path / "other").added_to(curve) == curve


def test_a_run_that_goes_on_from_before_a_look_looks_again(scenes, tmp_path: Path):
    for step in (2, 5, 9):
        watch(scenes, tmp_path)(wrong, step=step, seconds=float(step))
    again = watch(scenes, tmp_path)
    again(right(scenes), step=5, seconds=5.0)
    assert [(point["step"], point["msc_fg"]) for point in load_curve(again.path) or []] == [(2.0, 0.0), (5.0, 1.0)]


def test_the_first_clips_are_looked_at(scenes, tmp_path: Path):
    seen = []

    def count(clip: Clip) -> Prediction:
        seen.append(clip)
        return wrong(clip)

    watch(scenes * CLIPS, tmp_path)(count, step=1, seconds=1.0)
    assert len(seen) == CLIPS
    assert all(clip.truth is None for clip in seen)


def test_the_first_frames_of_long_clips_are_looked_at(tmp_path: Path):
    seen = []

    def count(clip: Clip) -> Prediction:
        seen.append(len(clip.rgb))
        return wrong(clip)

    watch([clip_and_truth(0, frames=FRAMES + 2, resolution=(32, 24))], tmp_path)(count, step=1, seconds=1.0)
    assert seen == [FRAMES]


def test_pixels_without_depth_do_not_count(scenes, tmp_path: Path):
    clip, truth = scenes[0]
    blind = Clip(clip.rgb, clip.depth, clip.valid & (truth == 0), clip.k, clip.world_from_camera)
    seen = watch([(blind, truth)], tmp_path)
    seen(wrong, step=1, seconds=1.0)
    assert np.isnan((load_curve(seen.path) or [])[0]["msc_fg"])
