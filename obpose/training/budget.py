"""Budget of a training in steps or time, and the learning rate."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch

from obpose.config import TrainConfig

VALIDATIONS = 10
"""Smallest number of validations."""
STEPS_BETWEEN, SECONDS_BETWEEN = 1000, 300.0
"""Largest distance between two validations."""


@dataclass(frozen=True)
class Budget:
    """Budget of a number of steps, or of seconds."""

    steps: int | None
    seconds: float

    @classmethod
    def of(cls, config: TrainConfig) -> "Budget":
        """Give the budget of a configuration."""
        return cls(config.steps, 60 * config.minutes)

    def fraction(self, step: int, seconds: float) -> float:
        """Share of the budget that is used after these steps and seconds, 0 to 1."""
        used = step / self.steps if self.steps is not None else seconds / self.seconds
        return min(used, 1.0)

    @property
    def validations(self) -> int:
        """Number of validations, which is larger in long trainings."""
        most = self.steps / STEPS_BETWEEN if self.steps is not None else self.seconds / SECONDS_BETWEEN
        return max(VALIDATIONS, math.ceil(most))

    def validation_is_due(self, before: float, now: float) -> bool:
        """Whether a validation is due between two fractions of the budget; the last one is at its end."""
        return math.floor(now * self.validations) > math.floor(before * self.validations)


HALVINGS = 1
"""Number of halvings of the learning rate over the budget, with `halving`."""


def learning_rate(config: TrainConfig, fraction: float) -> float:
    """Learning rate at a fraction of the budget."""
    rate = config.learning_rate * (fraction / config.rise if fraction < config.rise else 1.0)
    if config.decay == "none":
        return rate
    if config.decay == "halving":
        return rate * 0.5 ** (HALVINGS * fraction)
    return rate * 0.5 * (1 + math.cos(math.pi * fraction))


class Stopwatch:
    """Stopwatch of the time in training steps, which excludes validation, checkpoints and pictures.

    It counts the CPU time of the process on a CPU, which does not depend on other load, and wall time on a GPU.
    """

    def __init__(self, device: torch.device, seconds: float = 0.0):
        self.seconds = seconds
        self._now = time.process_time if device.type == "cpu" else time.monotonic

    @contextmanager
    def running(self) -> Iterator[None]:
        """Count the time of the block."""
        begin = self._now()
        yield
        self.seconds += self._now() - begin
