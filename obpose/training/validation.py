"""Validation on held-out clips during training; for inspection only, never for model selection."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Int

from obpose.config import TrainConfig, Views
from obpose.data.clips import ClipSource, observation_of, separate_views
from obpose.trainable import Trainable
from obpose.types import Observation

Labels = Int[np.ndarray, "frame view height width"]


def segment_clip(model: Trainable, clip: Observation, views: Views) -> Labels:
    """Segment a batch of one clip, 0 = background. Labels of separate views are unrelated."""
    if views == "all":
        labels = rearrange(model.segment(clip).labels, "1 frame view h w -> frame view h w")
    else:
        labels = rearrange(model.segment(separate_views(clip)).labels, "view frame 1 h w -> frame view h w")
    return labels.cpu().numpy()


CLIPS = 16
"""Number of clips used, from the first on. Images that are pasted for losses also show objects of later clips."""
SEGMENTATION = "segmentation"
"""Name of the labels in the windows of a labelled source."""

_SEED = 0

Score = Callable[[Labels, Labels], float]
"""Score from the true and the predicted labels of a clip; nan if undefined."""


@dataclass(frozen=True)
class CurvePoint:
    """Result of one validation."""

    step: int
    seconds: float
    """Time spent in training steps so far, as counted by the budget."""
    losses: dict[str, float]
    """Loss terms by name, means over the windows."""
    ari_fg: float | None
    """Mean ARI-FG over the clips; None without labels or without a score."""

    def row(self) -> dict[str, float | int]:
        """Convert to a row of a CSV table."""
        score = {} if self.ari_fg is None else {"ari_fg": self.ari_fg}
        return {"step": self.step, "seconds": round(self.seconds, 3), **score, **self.losses}

    def plain(self) -> dict[str, Any]:
        """Convert to a dict of JSON values."""
        return asdict(self)

    @classmethod
    def from_plain(cls, plain: dict[str, Any]) -> "CurvePoint":
        """Rebuild a point: the inverse of `plain`.

        Raises:
            AttributeError, TypeError, ValueError: values are missing, unknown or not numbers.
        """
        point = cls(**plain)
        numbers = [point.step, point.seconds, *point.losses.values(), *([] if point.ari_fg is None else [point.ari_fg])]
        if not all(type(number) in (int, float) for number in numbers) or not isinstance(point.step, int):
            raise TypeError("expected numbers")
        if "total" not in point.losses or not all(isinstance(name, str) for name in point.losses):
            raise ValueError("expected losses with a total")
        return point


def validate(
    model: Trainable,
    source: ClipSource,
    losses_source: ClipSource,
    config: TrainConfig,
    *,
    step: int,
    fraction: float,
    seconds: float,
    device: torch.device,
    score: Score | None,
) -> CurvePoint:
    """Compute losses in training mode and, if a score is given, score the segmentations in evaluation mode.

    Args:
        model: The model.
        source: Clips to score.
        losses_source: `Trainable.training_source` of these clips.
        config: Settings of the training.
        step: Number of finished steps.
        fraction: Share of the budget that is used.
        seconds: Time spent in training steps.
        device: Where the model is.
        score: ARI-FG from the true and the predicted labels of a clip; None to compute losses only.
    """
    losses = validation_losses(model, losses_source, config, step=step, fraction=fraction, device=device)
    if score is None:
        return CurvePoint(step, seconds, losses, None)
    model.eval()
    try:
        return CurvePoint(step, seconds, losses, validation_score(model, source, config, score, device=device))
    finally:
        model.train()


def validation_losses(
    model: Trainable, source: ClipSource, config: TrainConfig, *, step: int, fraction: float, device: torch.device
) -> dict[str, float]:
    """Mean loss terms over the first frames of the clips, with identical noise each time."""
    noise = torch.Generator(device).manual_seed(_SEED)
    sums: dict[str, float] = {}
    scenes = 0
    for observation in _batches(source, config, model.observation_type):
        with torch.no_grad():
            terms = model.losses(observation.to(device), step=step, fraction=fraction, generator=noise)
        number = len(observation.depth)
        scenes += number
        sums = {name: sums.get(name, 0.0) + number * float(value) for name, value in terms.items()}
    return {name: value / scenes for name, value in sums.items()}


def validation_score(
    model: Trainable, source: ClipSource, config: TrainConfig, score: Score, *, device: torch.device
) -> float | None:
    """Mean score of the segmentations of whole clips; None if there are no labels or no defined scores.

    As in the benchmark, pixels without depth do not count.
    """
    values = []
    for index in range(_clips(source)):
        window = source.window(index, 0, source.frames_of_clip)
        if SEGMENTATION not in window:
            return None
        labels = segment_clip(model, observation_of([window]).to(device), config.views)
        truth = np.where(window["valid"].numpy(), window[SEGMENTATION].numpy(), 0)
        values.append(score(truth, labels))
    defined = [value for value in values if not np.isnan(value)]
    return float(np.mean(defined)) if defined else None


def _batches(source: ClipSource, config: TrainConfig, kind: type[Observation]) -> Iterator[Observation]:
    frames = min(config.frames, source.frames_of_clip)
    for first in range(0, _clips(source), config.batch):
        indices = range(first, min(first + config.batch, _clips(source)))
        observation = observation_of([source.window(index, 0, frames) for index in indices], kind)
        yield separate_views(observation) if config.views == "separate" else observation


def _clips(source: ClipSource) -> int:
    return min(CLIPS, len(source))
