"""ObPose as a model of the benchmark: clips to observations, labels back."""

from collections.abc import Sequence
from pathlib import Path
from typing import cast

import torch
from einops import rearrange

from benchmark.interface import Clip, Prediction
from obpose.checkpoint import load
from obpose.clips import ArrayClips, observation_of, views_apart
from obpose.config import Config, make_config
from obpose.measure import measure_scene
from obpose.model import ObPose
from obpose.resolution import fitting_model
from obpose.train import CurvePoint, train

BACKGROUND = 0
ATTENTION = "att"


class ObPoseSegmenter:
    """One of `obpose.config.VARIANTS`, trained on clips or loaded from a checkpoint; implements `Segmenter`."""

    parameters: int = 0
    device: str = "cpu"
    learning_curve: list[dict[str, float]] | None = None
    fit_seconds: float = float("nan")
    """Of the budget's clock, before the run was interrupted included."""

    def __init__(
        self,
        variant: str,
        *,
        slots: int,
        steps: int | None = None,
        folder: Path | None = None,
        checkpoint: Path | None = None,
    ):
        """Options as `benchmark.interface` offers them; `slots` counts the background, which the model does not."""
        self._changes = {"model.slots": slots - 1, "train.steps": steps}
        self._variant, self._folder, self._checkpoint = variant, folder, checkpoint

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Train, or go on with the training in the folder, for so many seconds of one core."""
        torch.set_num_threads(1)
        if self._checkpoint:
            self._model = cast(ObPose, load(self._checkpoint, ObPose)[0])
        else:
            self._model = self._train(train, val, seed=seed, budget=budget)
        self.parameters = sum(parameter.numel() for parameter in self._model.parameters())

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the background; slots count from 1. `att` are the attention masks."""
        source = ArrayClips([clip])
        observation = observation_of([source.window(0, 0, source.frames_of_clip)])
        model = fitting_model(self._model, observation)
        if model.config.train.views == "apart":
            found, axes = model.segment(views_apart(observation)), "view frame 1 h w -> frame view h w"
        else:
            found, axes = model.segment(observation), "1 frame view h w -> frame view h w"
        labels, attention = (rearrange(maps, axes).numpy() for maps in (found.labels, found.attention))
        return Prediction(labels, BACKGROUND, {ATTENTION: attention})

    def _train(self, clips: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> ObPose:
        source = ArrayClips(clips)
        validation = ArrayClips(val) if len(val) else None
        trained = train(source, validation, self._config(source, seed, budget), folder=self._folder)
        self.learning_curve = [_point(point) for point in trained.curve]
        self.fit_seconds = trained.seconds
        return cast(ObPose, trained.model)

    def _config(self, source: ArrayClips, seed: int, budget: float) -> Config:
        measured = measure_scene(source).changes()
        run = {"train.seed": seed, "train.minutes": budget / 60}
        return make_config(self._variant, **self._changes, **run, **measured)


def _point(point: CurvePoint) -> dict[str, float]:
    """Losses on validation clips; the names say that they are losses, for `benchmark.failed_seeds`."""
    losses = {"loss" if name == "total" else f"{name} loss": value for name, value in point.losses.items()}
    return {"step": float(point.step), "seconds": point.seconds, **losses}
