"""How well a model segments while it learns, on validation clips: for curves, and never for the model.

The model hands over a function that segments and is told nothing; what was seen goes into a file, and into the learning
curve when the training is over. So no score, which needs labels, can decide anything in a training.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Integer

from benchmark.metrics import clip_scores
from benchmark.models.interface import Clip, Prediction
from benchmark.results.curves import Curve, load_curve, save_curve

WATCHED = "watched"
CLIPS, FRAMES = 16, 5
"""The first so many validation clips are looked at, and of each so many frames, which takes seconds."""
SCORES = ("ari_fg", "msc_fg")

Segment = Callable[[Clip], Prediction]


@dataclass(frozen=True, eq=False)
class Watch:
    """Looks at a model at some steps of its training."""

    clips: Sequence[Clip]
    truths: Sequence[Integer[np.ndarray, "frame view height width"]]
    path: Path
    """Of a CSV file, which the run goes on with if it is interrupted."""

    def __call__(self, segment: Segment, *, step: int, seconds: float) -> None:
        """Score the model as it is after so many steps and seconds of its budget."""
        scores = [self._scores(segment, index) for index in range(min(CLIPS, len(self.clips)))]
        means = {name: _mean([score[name] for score in scores]) for name in SCORES}
        # What a run saw after its last checkpoint, before it was killed, is seen again.
        before = [point for point in self._points() if point["step"] < step]
        save_curve(self.path, [*before, {"step": float(step), "seconds": seconds, **means}])

    def added_to(self, curve: Sequence[Mapping[str, float]]) -> Curve:
        """A learning curve with the scores at its steps."""
        seen = {point["step"]: point for point in self._points()}
        return [{**seen.get(point.get("step", np.nan), {}), **point} for point in curve]

    def _points(self) -> Curve:
        return load_curve(self.path) or []

    def _scores(self, segment: Segment, index: int) -> Mapping[str, np.ndarray]:
        clip, truth = self.clips[index], self.truths[index][:FRAMES]
        seen = None if clip.truth is None else clip.truth[:FRAMES]
        clip = replace(clip, rgb=clip.rgb[:FRAMES], depth=clip.depth[:FRAMES], valid=clip.valid[:FRAMES], truth=seen)
        found = segment(clip)
        return clip_scores(truth, found.labels, found.background, ~clip.valid)


def _mean(values: Sequence[np.ndarray]) -> float:
    """Over all frames in which a score is defined."""
    frames = np.concatenate([*values, np.empty(0)])
    defined = frames[~np.isnan(frames)]
    return float(defined.mean()) if len(defined) else float("nan")
