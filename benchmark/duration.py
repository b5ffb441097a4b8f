"""How long a plan takes, and how long its jobs may take."""

import heapq
import math
from collections.abc import Iterable
from dataclasses import dataclass

from benchmark.plan import Plan
from benchmark.runner import Job
from benchmark.wording import counted

SCENE_SECONDS = 0.1
"""To make a scene of ten frames on one core; docs/performance.md has it measured."""
STARTING_SECONDS = 20.0
"""To compile and import before the first scene is made and the first step is trained."""
ASIDE = 1.08
"""Validation, checkpoints and pictures, which no budget counts, as a factor on the time of training."""
SCORING_SECONDS = 60.0
"""To segment, store and score 300 scenes of ten frames."""
GRACE_SECONDS = 3600.0
"""That a job may take beside training."""
SLOW = 2.0
"""Other load may make a second of one core last so many seconds; also the most seconds that a step may take."""


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
    scenes = sum(source.missing(splits) for source, splits in plan.splits.items())
    data = STARTING_SECONDS + scenes * SCENE_SECONDS / workers if scenes else 0.0
    training = _side_by_side((_training(job) for job in learning), workers)
    both = _side_by_side((_training(job) + SCORING_SECONDS * len(job.targets) for job in plan.jobs), workers)
    return Estimate(data, training, both - training)


def in_words(found: Estimate) -> str:
    """One line for people who wait."""
    parts = (("to make scenes", found.data), ("to train", found.training), ("to score", found.scoring))
    minutes = ", ".join(f"{math.ceil(seconds / 60)} {what}" for what, seconds in parts if seconds)
    return f"This takes about {counted(math.ceil(found.total / 60), 'minute')}, less where a run goes on: {minutes}."


def time_limit(job: Job) -> float:
    """Seconds after which a job's next row has failed, if the user does not say."""
    allowed = _training(job) if job.steps is None else float(job.steps)
    return GRACE_SECONDS + SLOW * allowed


def _training(job: Job) -> float:
    if not job.learns or job.checkpoint:
        return 0.0
    return STARTING_SECONDS + ASIDE * job.seconds


def _side_by_side(seconds: Iterable[float], workers: int) -> float:
    """Until the last of these ends, if so many run at a time and in this order."""
    ends = [0.0] * workers
    for duration in seconds:
        heapq.heapreplace(ends, ends[0] + duration)
    return max(ends)
