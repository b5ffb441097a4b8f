"""Estimated duration of a plan, and time limits of its jobs."""

import heapq
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from benchmark.execution.plan import Plan
from datagen.console.text import counted

SCENE_SECONDS = 0.1
"""Time to generate a scene of ten frames on one core; measured in docs/performance.md."""
STARTING_SECONDS = 20.0
"""Time for imports and compilation before the first scene or the first training step."""
ASIDE = 1.13
"""Factor on training time for work outside the budget: validation, curve scores, checkpoints and pictures."""
SCORING_SECONDS = 60.0
"""Time to segment, store and score 300 scenes of ten frames."""
GRACE_SECONDS = 3600.0
"""Time that a job may take in addition to training."""
SLOW = 2.0
"""Largest slowdown by other load: wall time per second of one core. Also the largest time per step, in seconds."""


@runtime_checkable
class Training(Protocol):
    """Work that may include training: a job."""

    @property
    def trains(self) -> bool:
        """Whether its model learns here."""
        ...

    @property
    def seconds(self) -> float:
        """Training budget in seconds; infinite if the budget is counted in steps."""
        ...

    @property
    def steps(self) -> int | None:
        """Training budget in steps; None if it is counted in seconds."""
        ...


@dataclass(frozen=True)
class Estimate:
    """Estimated duration of a plan, in seconds."""

    data: float
    training: float
    scoring: float

    @property
    def total(self) -> float:
        """Total duration."""
        return self.data + self.training + self.scoring


def estimate(plan: Plan, workers: int) -> Estimate | None:
    """Estimate how long a plan takes from scratch; None if that is unknown.

    It is unknown if budgets are counted in steps, or if no model learns; models that do not learn take seconds.
    """
    learning = [job for job in plan.jobs if job.learns]
    if not learning or any(math.isinf(_training(job)) for job in learning):
        return None
    data = _making(sum(source.missing(splits) for source, splits in plan.splits.items()), workers)
    training = _side_by_side((_training(job) for job in learning), workers)
    both = _side_by_side((_training(job) + SCORING_SECONDS * len(job.targets) for job in plan.jobs), workers)
    return Estimate(data, training, both - training)


def estimate_trainings(trainings: Iterable[Training], scenes: int, workers: int) -> Estimate | None:
    """Estimate the duration of trainings without scoring, after `scenes` scenes are generated."""
    seconds = [_training(training) for training in trainings]
    if not seconds or math.inf in seconds:
        return None
    return Estimate(_making(scenes, workers), _side_by_side(seconds, workers), 0.0)


def in_words(found: Estimate) -> str:
    """Format an estimate as one line for the user."""
    parts = (("to make scenes", found.data), ("to train", found.training), ("to score", found.scoring))
    minutes = ", ".join(f"{math.ceil(seconds / 60)} {what}" for what, seconds in parts if seconds)
    return f"This takes about {counted(math.ceil(found.total / 60), 'minute')}, less where a run goes on: {minutes}."


def time_limit(job: Training) -> float:
    """Seconds after which a job's next result has failed, if the user does not say."""
    allowed = _training(job) if job.steps is None else float(job.steps)
    return GRACE_SECONDS + SLOW * allowed


def _making(scenes: int, workers: int) -> float:
    return STARTING_SECONDS + scenes * SCENE_SECONDS / workers if scenes else 0.0


def _training(job: Training) -> float:
    if not job.trains:
        return 0.0
    return STARTING_SECONDS + ASIDE * job.seconds


def _side_by_side(seconds: Iterable[float], workers: int) -> float:
    """Time until the last job ends, if `workers` jobs run at a time and start in this order."""
    ends = [0.0] * workers
    for duration in seconds:
        heapq.heapreplace(ends, ends[0] + duration)
    return max(ends)
