"""Training steps on one thread, and which part of the model their CPU time goes into, forward and backward.

python -m tests.perf.training_step    steps of the authors' size in a process of their own; prints JSON
"""

import json
import resource
import time
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from functools import wraps
from itertools import count
from statistics import median
from typing import Any

import torch
from lightning_fabric import Fabric
from torch import Tensor
from torch.autograd.graph import Node

import obpose.model.obpose
from obpose.config import Config
from obpose.model.attention.icsbp import ICSBP
from obpose.model.build import build_obpose
from obpose.model.layers.latent import RecurrentLatent
from obpose.model.obpose import ObPose
from obpose.model.pose.encoder import ObjectEncoder
from obpose.model.pose.location import Where
from obpose.training.devices import keep_memory, make_fabric
from obpose.training.learner import Learner
from obpose.types import Observation
from obpose.variants import make_config
from tests.worlds.observations import table_scene

ENCODERS = "where and what"
REST = "rest"
"""Of a step: rays, background latent, norm of the gradient, Adam."""
PARTS = (
    (ObPose, "_embed", "backbone and heads"),
    (ICSBP, "forward", "attention"),
    (Where, "forward", ENCODERS),
    (ObPose, "_crop", ENCODERS),
    (ObjectEncoder, "forward", ENCODERS),
    (RecurrentLatent, "forward", ENCODERS),
    (obpose.model.obpose, "observed_rotation", "orientation"),
    (ObPose, "decode", "fields"),
    (obpose.model.obpose, "estimate_shape", "voxels"),
    (obpose.model.obpose, "observation_terms", "losses"),
    (obpose.model.obpose, "attention_loss", "losses"),
)
"""Owner and name of what is timed; what one part calls of another does not count for the caller."""


@dataclass
class Stopwatch:
    """CPU seconds of each part. Steps back through the graph count for the part that made them."""

    forward: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    backward: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    _parts: list[str] = field(default_factory=lambda: [REST])
    _since: float = 0.0
    _turns: list[tuple[int, str]] = field(default_factory=lambda: [(-1, REST)])
    """Number of the graph's first node that a part made; the part has all nodes up to the next turn."""

    def start(self) -> None:
        self._since = time.process_time()

    def stop(self) -> None:
        self._charge(self.forward, self._parts[-1])

    def within(self, part: str, call: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(call)
        def timed(*arguments: Any, **options: Any) -> Any:
            self._charge(self.forward, self._parts[-1])
            self._parts.append(part)
            self._turns.append((_next_node(), part))
            try:
                return call(*arguments, **options)
            finally:
                self._charge(self.forward, self._parts.pop())
                self._turns.append((_next_node(), self._parts[-1]))

        return timed

    def backwards(self, call: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(call)
        def timed(fabric: Fabric, loss: Tensor) -> None:
            self._charge(self.forward, self._parts[-1])
            at = [REST]

            def arrive(part: str) -> Callable[[object], None]:
                def turn(_gradients: object) -> None:
                    self._charge(self.backward, at[0])
                    at[0] = part

                return turn

            hooks = [node.register_prehook(arrive(self._part_of(node))) for node in _graph(loss)]
            self._since = time.process_time()
            call(fabric, loss)
            self._charge(self.backward, at[0])
            for hook in hooks:
                hook.remove()
            self._since = time.process_time()

        return timed

    def _charge(self, seconds: defaultdict[str, float], part: str) -> None:
        now = time.process_time()
        seconds[part] += now - self._since
        self._since = now

    def _part_of(self, node: Node) -> str:
        return self._turns[bisect_right(self._turns, node._sequence_nr(), key=lambda turn: turn[0]) - 1][1]


@dataclass(frozen=True)
class Step:
    """Medians over steps, CPU seconds."""

    total: float
    """Without any stopwatch."""
    parts: dict[str, tuple[float, float]]
    """Forward and backward."""

    def __str__(self) -> str:
        rows = sorted(self.parts.items(), key=lambda row: -sum(row[1]))
        return "\n".join(f"  {name:20}{1000 * there:6.0f} + {1000 * back:4.0f} ms" for name, (there, back) in rows)


def measure_steps(config: Config, clips: Observation, *, steps: int = 7) -> Step:
    """Training steps after the warm-up; those with a stopwatch in the middle, for a machine is not always as fast."""
    learn = _learner(config, clips)
    learn()
    before, watches = _timed(learn, steps), []
    for _ in range(steps):
        with watched() as watch:
            learn()
        watches.append(watch)
    learn()
    totals = before + _timed(learn, steps)
    names = {name for watch in watches for name in (*watch.forward, *watch.backward)}
    parts = {
        name: (median(watch.forward[name] for watch in watches), median(watch.backward[name] for watch in watches))
        for name in names
    }
    return Step(median(totals), parts)


def _timed(learn: Callable[[], None], steps: int) -> list[float]:
    times = []
    for _ in range(steps):
        start = time.process_time()
        learn()
        times.append(time.process_time() - start)
    return times


def _learner(config: Config, clips: Observation) -> Callable[[], None]:
    """Makes the next step after the warm-up."""
    learner = Learner(make_fabric("cpu", config.train), config, build_obpose)
    batch = {field.name: getattr(clips, field.name) for field in fields(clips)}
    numbers = count(config.train.warmup)

    def learn() -> None:
        learner.step(batch, step=next(numbers), fraction=0.5, learning_rate=1e-4)

    return learn


@contextmanager
def watched() -> Iterator[Stopwatch]:
    watch = Stopwatch()
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in PARTS] + [(Fabric, "backward", Fabric.backward)]
    for owner, name, part in PARTS:
        setattr(owner, name, watch.within(part, getattr(owner, name)))
    Fabric.backward = watch.backwards(Fabric.backward)
    watch.start()
    try:
        yield watch
    finally:
        watch.stop()
        for owner, name, call in before:
            setattr(owner, name, call)


def clips(batch: int, size: int) -> Observation:
    """Five frames each, with four spheres on a table."""
    return table_scene(batch=batch, frames=5, height=size, width=size, spheres=4)


def config_for_clips(variant: str, profile: str, **changes: Any) -> Config:
    """With the sizes that `obpose.data.scene_stats` would find."""
    measured = {"model.workspace_center": (0.0, 0.0, 0.1), "model.workspace_size": 1.0, "model.background_size": 1.5}
    return make_config(variant, profile, **measured, **changes)


def authors_step() -> Step:
    """One clip of 5 frames of 128x128, all rays, boxes of 40 cm, 24^3 voxels in every frame, as theirs."""
    estimate = obpose.model.obpose.estimate_shape
    obpose.model.obpose.estimate_shape = lambda *arguments, frame, **options: estimate(*arguments, **options)
    same = {"train.batch": 1, "model.spacing": 0.006, "model.pose.box_size": 0.4, "model.table": None}
    try:
        return measure_steps(config_for_clips("obpose", "paper", **same), clips(1, 128), steps=3)
    finally:
        obpose.model.obpose.estimate_shape = estimate


def sgemm_rate(rows: int = 16384, width: int = 128) -> float:
    """Floating-point operations a second in a matrix product of the size of a field's layers."""
    a, b, times = torch.randn(rows, width), torch.randn(width, width), []
    for _ in range(40):
        start = time.process_time()
        torch.mm(a, b)
        times.append(time.process_time() - start)
    return 2 * rows * width * width / median(times)


def _next_node() -> int:
    """Number that the next node of the graph gets."""
    with torch.enable_grad():
        node = torch.zeros((), requires_grad=True).clone().grad_fn
    assert node is not None
    return node._sequence_nr()


def _graph(loss: Tensor) -> Iterator[Node]:
    """Its nodes, but for those that add to parameters' gradients."""
    seen, left = set(), [loss.grad_fn]
    while left:
        node = left.pop()
        if node is None or node in seen or node.name().endswith("AccumulateGrad"):
            continue
        seen.add(node)
        left += [following for following, _ in node.next_functions]
        yield node


def main() -> None:
    torch.set_num_threads(1)
    keep_memory()
    before = sgemm_rate()
    step = authors_step()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    rate = median([before, sgemm_rate()])
    print(json.dumps({"step": asdict(step), "sgemm": rate, "gigabytes": peak}))


if __name__ == "__main__":
    main()
