"""Choosing a model's options: the validation split's labels score each declared value; the model never sees them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Integer

from benchmark.metrics import clip_scores
from benchmark.models.interface import Clip, Segmenter
from benchmark.models.model_spec import ModelSpec, Options

CRITERION = "msc_fg"
FRAMES = 300
"""Frames that one value is scored on; the standard error of their MSC-FG is about 0.01, and shared by all values."""

Labels = Integer[np.ndarray, "frame view height width"]
Sample = tuple[Clip, Integer[np.ndarray, "kept_frame view height width"]]


@dataclass(frozen=True)
class Choice:
    """What tuning found."""

    options: Options
    """`slots` and the chosen value of the grid."""
    scores: tuple[float, ...]
    """MSC-FG of every value, in the grid's order; empty where there was nothing to choose."""


def choose(
    spec: ModelSpec,
    options: Options,
    train: Sequence[Clip],
    val: Sequence[Clip],
    truths: Sequence[Labels],
    *,
    seed: int,
    budget: float,
    limit: int = FRAMES,
) -> Choice:
    """The value of the model's grid with the best MSC-FG on validation clips; of equal ones the first.

    Every value is fitted anew, with an equal part of `budget`, and scored on at most `limit` frames (not counting
    views), spread evenly over the clips and over the frames of each. A value that never has a defined score loses.
    """
    if len(spec.grid) < 2:
        return Choice({**options, **spec.default}, ())
    sample = subsample(val, truths, limit)
    scores = []
    for value in spec.grid:
        model = spec.build({**options, **value})
        model.fit(train, val, seed=seed, budget=budget / len(spec.grid))
        scores.append(_criterion(model, sample))
    best = int(np.argmax(np.nan_to_num(scores, nan=-np.inf)))
    return Choice({**options, **spec.grid[best]}, tuple(scores))


def subsample(clips: Sequence[Clip], truths: Sequence[Labels], limit: int) -> list[Sample]:
    """At most `limit` frames: of every clip as many, spread evenly, or one each of as many clips."""
    chosen = _spread(len(clips), limit)
    return [_thinned(clips[i], truths[i], limit // max(len(chosen), 1)) for i in chosen]


def _thinned(clip: Clip, truth: Labels, count: int) -> Sample:
    """A clip of `count` of its frames, or of all where it has fewer."""
    frames = _spread(len(clip.rgb), count)
    seen = None if clip.truth is None else clip.truth[frames]
    thin = replace(clip, rgb=clip.rgb[frames], depth=clip.depth[frames], valid=clip.valid[frames], truth=seen)
    return thin, truth[frames]


def _spread(length: int, count: int) -> list[int]:
    """At most `count` indices, each in the middle of an equal part of the range."""
    count = min(length, count)
    return [(2 * i + 1) * length // (2 * count) for i in range(count)]


def _criterion(model: Segmenter, sample: Sequence[Sample]) -> float:
    """Mean of the criterion over all frames in which it is defined; pixels without depth do not count."""
    values = []
    for clip, truth in sample:
        prediction = model.segment(clip)
        values.append(clip_scores(truth, prediction.labels, prediction.background, ~clip.valid)[CRITERION])
    pooled = np.concatenate(values)
    return float(np.nanmean(pooled)) if np.any(~np.isnan(pooled)) else float("nan")
