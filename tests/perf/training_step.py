"""CPU time of training steps on one thread.

python -m tests.perf.training_step    steps of the authors' size in a process of their own; prints JSON
"""

import json
import resource
import time
from collections.abc import Callable
from dataclasses import fields
from itertools import count
from statistics import median
from typing import Any

import torch

import obpose.model.obpose
from obpose.config import Config
from obpose.model.build import build_obpose
from obpose.training.devices import keep_memory, make_fabric
from obpose.training.learner import Learner
from obpose.types import Observation
from obpose.variants import make_config
from tests.worlds.observations import table_scene


def measure_steps(config: Config, clips: Observation, *, steps: int = 14) -> float:
    """Median CPU seconds of a training step after the warm-up."""
    learner = Learner(make_fabric("cpu", config.train), config, build_obpose)
    batch = {field.name: getattr(clips, field.name) for field in fields(clips)}
    numbers = count(config.train.warmup)

    def learn() -> None:
        learner.step(batch, step=next(numbers), fraction=0.5, learning_rate=1e-4)

    learn()
    return median(_timed(learn, steps))


def _timed(act: Callable[[], object], times: int) -> list[float]:
    seconds = []
    for _ in range(times):
        start = time.process_time()
        act()
        seconds.append(time.process_time() - start)
    return seconds


def clips(batch: int, size: int) -> Observation:
    """Five frames each, with four spheres on a table."""
    return table_scene(batch=batch, frames=5, height=size, width=size, spheres=4)


def config_for_clips(variant: str, profile: str, **changes: Any) -> Config:
    """With the sizes that `obpose.data.scene_stats` would find."""
    measured = {"model.workspace_center": (0.0, 0.0, 0.1), "model.workspace_size": 1.0, "model.background_size": 1.5}
    return make_config(variant, profile, **measured, **changes)


def authors_step() -> float:
    """One clip of 5 frames of 128x128, all rays, boxes of 40 cm, 24^3 voxels in every frame, as theirs."""
    estimate = obpose.model.obpose.estimate_shape
    obpose.model.obpose.estimate_shape = lambda *arguments, frame, **options: estimate(*arguments, **options)
    same = {"train.batch": 1, "model.spacing": 0.006, "model.pose.box_size": 0.4, "model.table": None}
    try:
        return measure_steps(config_for_clips("obpose", "paper", **same), clips(1, 128), steps=6)
    finally:
        obpose.model.obpose.estimate_shape = estimate


def sgemm_rate(rows: int = 16384, width: int = 128) -> float:
    """Floating-point operations a second in a matrix product of the size of a field's layers."""
    a, b = torch.randn(rows, width), torch.randn(width, width)
    return 2 * rows * width * width / median(_timed(lambda: torch.mm(a, b), 40))


def main() -> None:
    torch.set_num_threads(1)
    keep_memory()
    before = sgemm_rate()
    step = authors_step()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    rate = median([before, sgemm_rate()])
    print(json.dumps({"step": step, "sgemm": rate, "gigabytes": peak}))


if __name__ == "__main__":
    main()
