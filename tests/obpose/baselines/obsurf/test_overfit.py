"""What ObSuRF learns in a minute: to tell a ball from the table that it lies on.

Of two balls it makes one slot for far longer; what tells them apart has to be learned from many more scenes.
"""

from typing import Any

import numpy as np
import pytest
import torch

from benchmark.metrics import clip_scores
from obpose.geometry import unproject
from obpose.systems import find_system
from obpose.train import train
from tests.obpose.scenes import ball_scenes

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

SMALL: dict[str, Any] = {
    "model.slots": 1,
    "model.encoder.width": 32,
    "model.decoder.width": 8,
    "model.decoder.depth": 2,
    "model.decoder.pixel_features": False,
    "model.last_octave": -3,
    "loss.colour_std": 0.1,
    "train.batch": 8,
    "train.steps": 1500,
    "train.learning_rate": 2e-3,
}
"""Fields so small that two slots describe a table with a ball on it better than one."""


class Balls:
    """Scenes of one frame with one ball each, and which pixels are its."""

    frames_of_clip = 1

    def __init__(self, scenes: int):
        self.scenes = ball_scenes(scenes)
        self.labels = (unproject(self.scenes)[..., 2] > 1e-4).long()

    def __len__(self) -> int:
        return len(self.labels)

    def window(self, index: int, start: int, frames: int) -> dict[str, torch.Tensor]:
        return {name: value[index] for name, value in vars(self.scenes).items()}


@pytest.mark.parametrize("name", ["obsurf-no-overlap", "obsurf-no-overlap-depth"])
def test_balls_are_told_from_the_table(name: str):
    balls = Balls(200)
    model = train(balls, None, find_system(name).config("cpu", SMALL), device="cpu").model
    labels = model.segment(balls.scenes).labels
    scores = [
        clip_scores(truth.numpy(), found.numpy(), 0)["ari"] for truth, found in zip(balls.labels, labels, strict=True)
    ]
    assert np.mean(scores) > 0.95
