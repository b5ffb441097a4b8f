"""Files of a training: checkpoints, curves and pictures.

RUN/config.json, model.safetensors     the model, for `obpose.storage.checkpoint.load`
RUN/training.safetensors               the state from which the training resumes
RUN/training.csv, validation.csv       curves
RUN/pictures/                          pictures of some clips, at each validation
RUN/tensorboard/                       the curves for TensorBoard, if requested
"""

import time
from pathlib import Path
from typing import Any

from obpose.data.clips import ClipSource, observation_of
from obpose.pictures import write_picture
from obpose.storage.checkpoint import STEPS, VALIDATIONS, save_model, save_training
from obpose.trainable import Configuration, Trainable
from obpose.training.learner import Learner, StepResult
from obpose.training.logs import CsvLog, TensorBoardLog
from obpose.training.validation import CurvePoint

SAVE_SECONDS = 180.0
"""Wall time between two checkpoints."""
PICTURE_CLIPS = 3
"""Number of clips that are drawn, from the first on."""


class Record:
    """Writer of a run's folder, which only this process may write."""

    def __init__(self, folder: Path, config: Configuration, *, steps: int, tensorboard: bool, save_seconds: float):
        """Start, or resume after `steps` steps; checkpoints are due every `save_seconds`."""
        self._folder, self._config, self._save_seconds = folder, config, save_seconds
        self._steps = CsvLog(folder / STEPS, steps=steps)
        self._validations = CsvLog(folder / VALIDATIONS, steps=steps)
        self._board = TensorBoardLog(folder / "tensorboard", steps=steps) if tensorboard else None
        self._saved = time.monotonic()

    def log_step(self, step: int, seconds: float, learning_rate: float, result: StepResult) -> None:
        """Add a row to the curves of the training."""
        row = {
            "step": step,
            "seconds": round(seconds, 3),
            "learning_rate": learning_rate,
            "gradient_norm": result.gradient_norm,
            **result.losses,
        }
        self._steps.write(row)
        if self._board:
            self._board.write("training", row)

    def log_validation(self, point: CurvePoint) -> None:
        """Add a row to the curves of the validation."""
        self._validations.write(point.row())
        if self._board:
            self._board.write("validation", point.row())

    def draw(self, model: Trainable, source: ClipSource, *, step: int, device: Any) -> None:
        """Draw pictures of the model's results on some clips."""
        frames = min(self._config.train.frames, source.frames_of_clip)
        windows = [source.window(index, 0, frames) for index in range(min(PICTURE_CLIPS, len(source)))]
        path = self._folder / "pictures" / f"step-{step:07d}.png"
        write_picture(path, model, observation_of(windows).to(device), self._config.train.views)

    def save(self, learner: Learner, info: dict[str, Any]) -> None:
        """Write a checkpoint."""
        state = learner.state(info)
        save_training(self._folder, state)
        save_model(self._folder, state.weights, self._config, info)
        self._saved = time.monotonic()

    def save_is_due(self) -> bool:
        """Whether the last checkpoint is older than `save_seconds`."""
        return time.monotonic() - self._saved > self._save_seconds

    def close(self) -> None:
        """Flush pending values."""
        if self._board:
            self._board.close()
