"""How long a plan takes, and how long its jobs may take."""

import heapq
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from benchmark.plan import Plan
from datagen.wording import counted

SCENE_SECONDS = 0.1
"""To make a scene of ten frames on one core; docs/performance.md has it measured."""
STARTING_SECONDS = 20.0
"""To compile and import before the first scene is made and the first step is trained."""
ASIDE = 1.13
"""Validation, scores for curves, checkpoints and pictures, which no budget counts, as a factor on the time of
training."""
SCORING_SECONDS = 60.0
"""To segment, store and score 300 scenes of ten frames."""
GRACE_SECONDS = 3600.0
"""That a job may take beside training."""
SLOW = 2.0
"""Other load may make a second of one core last so many seconds; also the most seconds that a step may take."""


@runtime_checkable
class Training(Protocol):
    """What trains, or does not: a job, or a trial of a search."""

    @property
    def trains(self) -> bool:
        """Whether its model learns here."""
        ...

    @property
    def seconds(self) -> float:
        """That it may learn for; infinite where it counts steps."""
        ...

    @property
    def steps(self) -> int | None:
        """In their place."""
        ...


@dataclass(frozen=True)
class Estimate:
    """Seconds that a plan takes."""

    data: float
    training: float
    scoring: float

    @property
    def total(self) -> float:
        """All together."""
        return self.data + self.training + self.scoring


def estimate(plan: Plan, workers: int) -> Estimate | None:
    """How long a plan takes, if nothing of it was begun before; None where nobody knows.

    That is where no model learns, since those that do not take seconds, or where budgets are counted in steps.
    """
    learning = [job for job in plan.jobs if job.learns]
    if not learning or any(math.isinf(_training(job)) for job in learning):
        return None
    data = _making(sum(source.missing(splits) for source, splits in plan.splits.items()), workers)
    training = _side_by_side((_training(job) for job in learning), workers)
    both = _side_by_side((_training(job) + SCORING_SECONDS * len(job.targets) for job in plan.jobs), workers)
    return Estimate(data, training, both - training)


def estimate_trainings(trainings: Iterable[Training], scenes: int, workers: int) -> Estimate | None:
    """The same of trainings that nothing is scored after, with so many scenes to be made first."""
    seconds = [_training(training) for training in trainings]
    if not seconds or math.inf in seconds:
        return None
    return Estimate(_making(scenes, workers), _side_by_side(seconds, workers), 0.0)


def in_words(found: Estimate) -> str:
    """One line for people who wait."""
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
    """Until the last of these ends, if so many run at a time and in this order."""
    ends = [0.0] * workers
    for duration in seconds:
        heapq.heapreplace(ends, ends[0] + duration)
    return max(ends)
