"""Validation scores of a model while it learns, for learning curves; the model cannot use them.

The model passes a function that segments clips, and gets nothing back. The scores go into a file, and into the learning
curve when training is over. So no score, which needs labels, can influence a training.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Integer

from benchmark.csv_files import Curve, load_curve, save_curve
from benchmark.metrics import clip_scores, mean_where_defined
from benchmark.models.interface import Clip, Prediction
from datagen.errors import CorruptFile

VALIDATION = "watched"
"""Subfolder of the run folder for these scores."""
CLIPS, FRAMES = 16, 5
"""Numbers of validation clips that are scored, and of frames in each, from the first on; they take seconds."""
SCORES = ("ari_fg", "msc_fg")

Segment = Callable[[Clip], Prediction]


@dataclass(frozen=True, eq=False)
class ValidationScorer:
    """Scores a model at some steps of its training."""

    clips: Sequence[Clip]
    truths: Sequence[Integer[np.ndarray, "frame view height width"]]
    path: Path
    """CSV file of the scores; a resumed training continues it."""

    def __call__(self, segment: Segment, *, step: int, seconds: float) -> None:
        """Score the model as it is after `step` steps and `seconds` seconds of its budget."""
        scores = [self._scores(segment, index) for index in range(min(CLIPS, len(self.clips)))]
        frames = {name: [np.empty(0), *(score[name] for score in scores)] for name in SCORES}
        means = {name: mean_where_defined(np.concatenate(values)) for name, values in frames.items()}
        # A resumed training repeats the steps after its last checkpoint.
        before = [point for point in self._points() if point["step"] < step]
        save_curve(self.path, [*before, {"step": float(step), "seconds": seconds, **means}])

    def added_to(self, curve: Sequence[Mapping[str, float]]) -> Curve:
        """Add the scores to the points of a learning curve at the same steps."""
        scores = {point["step"]: point for point in self._points()}
        return [{**scores.get(point.get("step", np.nan), {}), **point} for point in curve]

    def _points(self) -> Curve:
        points = load_curve(self.path) or []
        if not all("step" in point for point in points):
            raise CorruptFile(f"{self.path} has no column step; delete it and run the same command again.")
        return points

    def _scores(self, segment: Segment, index: int) -> Mapping[str, np.ndarray]:
        clip, truth = self.clips[index].select(slice(FRAMES)), self.truths[index][:FRAMES]
        found = segment(clip)
        return clip_scores(truth, found.labels, found.background, ~clip.valid)
