"""Choose a model's options by their scores on labelled validation clips; the model never gets the labels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Integer

from benchmark.metrics import clip_scores
from benchmark.models.interface import Clip, Segmenter
from benchmark.models.model_spec import ModelSpec, Options

CRITERION = "msc_fg"
FRAMES = 300
"""Frames that each value is scored on; the standard error of their MSC-FG is about 0.01, and shared by all values."""

Labels = Integer[np.ndarray, "frame view height width"]
Sample = tuple[Clip, Integer[np.ndarray, "kept_frame view height width"]]


@dataclass(frozen=True)
class Choice:
    """Result of tuning."""

    options: Options
    """The given options and the chosen value of the grid."""
    scores: tuple[float, ...]
    """MSC-FG of every value, in the grid's order; empty if there is only one value."""


def choose(
    spec: ModelSpec,
    options: Options,
    train: Sequence[Clip],
    val: Sequence[Clip],
    truths: Sequence[Labels],
    *,
    seed: int,
    budget: float,
) -> Choice:
    """Choose the value of the model's grid with the best MSC-FG on validation clips; the first of equal ones.

    A new model is fitted for every value, with an equal part of `budget`. It is scored on at most `FRAMES` frames (not
    counting views), spread evenly over the clips and over the frames of each. Values without a defined score lose.
    """
    if len(spec.grid) < 2:
        return Choice({**options, **spec.default}, ())
    sample = subsample(val, truths, FRAMES, whole_clips=spec.uses_time)
    scores = []
    for value in spec.grid:
        model = spec.build({**options, **value})
        model.fit(train, val, seed=seed, budget=budget / len(spec.grid))
        scores.append(_criterion(model, sample))
    best = int(np.argmax(np.nan_to_num(scores, nan=-np.inf)))
    return Choice({**options, **spec.grid[best]}, tuple(scores))


def subsample(
    clips: Sequence[Clip], truths: Sequence[Labels], limit: int, *, whole_clips: bool = False
) -> list[Sample]:
    """Select at most `limit` frames, evenly: the same number of every clip, or one frame each of fewer clips.

    With `whole_clips`, select all frames of as many clips as have at most `limit` frames, but of at least one clip.
    """
    length = len(clips[0].rgb) if whole_clips and len(clips) else 1
    chosen = evenly_spaced(len(clips), max(1, limit // length))
    sample = []
    for i in chosen:
        frames = evenly_spaced(len(clips[i].rgb), length if whole_clips else limit // max(len(chosen), 1))
        sample.append((clips[i].select(frames), truths[i][frames]))
    return sample


def evenly_spaced(length: int, count: int) -> list[int]:
    """Choose at most `count` indices, each in the middle of an equal part of the range."""
    count = min(length, count)
    return [(2 * i + 1) * length // (2 * count) for i in range(count)]


def _criterion(model: Segmenter, sample: Sequence[Sample]) -> float:
    """Mean of the criterion over all frames in which it is defined; pixels without depth are ignored."""
    values = []
    for clip, truth in sample:
        prediction = model.segment(clip)
        values.append(clip_scores(truth, prediction.labels, prediction.background, ~clip.valid)[CRITERION])
    pooled = np.concatenate(values)
    return float(np.nanmean(pooled)) if np.any(~np.isnan(pooled)) else float("nan")
