"""How long a training lasts, how far it is, and its learning rate."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import torch

from obpose.config import TrainConfig

VALIDATIONS = 10
STEPS_BETWEEN, SECONDS_BETWEEN = 1000, 300.0
"""At most so far apart are two validations."""
SKIP_FROM = 0.1
"""Share of the budget in which no step is skipped: gradients are large at first."""


@dataclass(frozen=True)
class Budget:
    """So many steps, or so many seconds."""

    steps: int | None
    seconds: float

    @classmethod
    def of(cls, config: TrainConfig) -> "Budget":
        """The budget of a configuration."""
        return cls(config.steps, 60 * config.minutes)

    def fraction(self, step: int, seconds: float) -> float:
        """Share of it that is used after so many steps and seconds, 0 to 1."""
        used = step / self.steps if self.steps is not None else seconds / self.seconds
        return min(used, 1.0)

    @property
    def validations(self) -> int:
        """How often to look at validation clips: ten times, and more often in long trainings."""
        most = self.steps / STEPS_BETWEEN if self.steps is not None else self.seconds / SECONDS_BETWEEN
        return max(VALIDATIONS, math.ceil(most))

    def validation_is_due(self, before: float, now: float) -> bool:
        """Whether one falls between two fractions of the budget; the last falls on its end."""
        return math.floor(now * self.validations) > math.floor(before * self.validations)


def learning_rate(config: TrainConfig, fraction: float) -> float:
    """At a fraction of the budget; `cosine` falls to zero at its end."""
    if config.decay == "none":
        return config.learning_rate
    if config.decay == "halving":
        return config.learning_rate * 0.5 ** (fraction / config.half_life)
    return config.learning_rate * 0.5 * (1 + math.cos(math.pi * fraction))


def is_skipped(config: TrainConfig, fraction: float, gradient_norm: float) -> bool:
    """Whether a step at a fraction of the budget changes nothing because its gradient has exploded."""
    return config.skip > 0 and fraction >= SKIP_FROM and gradient_norm > config.skip


class Stopwatch:
    """Seconds spent in training steps; what stands between them (validating, saving, drawing) does not count.

    On a CPU it is CPU time of this process, which other load on the machine does not change; on a GPU, time of day.
    """

    def __init__(self, device: torch.device, seconds: float = 0.0):
        self.seconds = seconds
        self._now = time.process_time if device.type == "cpu" else time.monotonic

    @contextmanager
    def running(self) -> Iterator[None]:
        """Count what happens within."""
        begin = self._now()
        yield
        self.seconds += self._now() - begin
