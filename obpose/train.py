"""Training: from clips without labels and a configuration to a model (paper, section Training).

    trained = train(SceneDataset(folder), SceneDataset(folder, "val"), config, folder=Path("runs/one"))

Which clips a step sees and all its noise follow from the seed and the number of the step, so that a run that was
stopped goes on exactly as if it had not been. With a budget in minutes the learning rate follows the time that steps
took, which is never the same twice; with one in steps the weights are equal to the last bit.
"""

import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning_fabric import Fabric

from benchmark.metrics import clip_scores
from datagen.wording import counted
from obpose.checkpoint import TRAINING, Build, load_training
from obpose.clips import ClipSource
from obpose.errors import CorruptFile, Interrupted, UsageError
from obpose.files import claimed
from obpose.labels import Labels
from obpose.systems import build_model
from obpose.trainable import Configuration, Trainable
from obpose.training.batches import Sampling, Share, batches, readers_for
from obpose.training.budget import Budget, Stopwatch, learning_rate
from obpose.training.devices import keep_memory, leave, make_fabric, mean_over_processes
from obpose.training.guard import check_validation
from obpose.training.learner import Learner
from obpose.training.record import Record
from obpose.training.signals import StopRequest, stop_on_signals
from obpose.training.validation import CurvePoint, validate

__all__ = ["CurvePoint", "Status", "Trained", "train"]


@dataclass(frozen=True)
class Status:
    """How far a training is."""

    step: int
    """Steps that are done."""
    seconds: float
    """Of the budget's clock: CPU time of this process in training steps, on a GPU time of day."""
    fraction: float
    """Of the budget that is used."""
    losses: dict[str, float]
    """Of the last step."""
    validation: CurvePoint | None
    """The latest one."""


Report = Callable[[Status], None]
"""Is told after each step."""


@dataclass(frozen=True, eq=False)
class Trained:
    """What came out."""

    model: Trainable
    """On the CPU, in evaluation mode."""
    config: Configuration
    steps: int
    seconds: float
    """Of the budget's clock."""
    curve: tuple[CurvePoint, ...]
    """For people to look at."""


def say_nothing(status: Status) -> None:
    """Report to nobody."""


Look = Callable[[Trainable, int, float], None]
"""Is shown the model at each validation, in evaluation mode, with the steps and the seconds that are done."""


def look_away(model: Trainable, step: int, seconds: float) -> None:
    """See nothing."""


def train(
    source: ClipSource,
    val_source: ClipSource | None,
    config: Configuration,
    *,
    folder: Path | None = None,
    report: Report = say_nothing,
    look: Look = look_away,
    device: str = "auto",
    tensorboard: bool = False,
    build: Build = build_model,
) -> Trained:
    """Train a model until its budget, `config.train.minutes` or `.steps`, is used up.

    Args:
        source: Clips to learn from.
        val_source: Clips to measure losses on, and ARI-FG where they carry labels; shown and logged, nothing else.
        config: Everything that the result depends on, with the measures of the scene (`obpose.measure.measure_scene`).
        folder: Where checkpoints, curves and pictures go, and where an interrupted run goes on from; None for nowhere.
        report: Is told how it goes after each step.
        look: Is shown the model at each validation; what it does there counts for nothing, in the budget neither.
        device: `auto` (a GPU if there is one), `cpu` or `cuda`.
        tensorboard: Whether the folder gets curves for TensorBoard, too.
        build: Makes the model; if left out, the one that the configuration is of.

    Raises:
        UsageError: there are no clips, or the folder holds a run of another configuration or is in use.
        Diverged: losses or gradients are not finite any more.
        Interrupted: SIGTERM or SIGINT came, and the state has been saved.
    """
    if not len(source):
        raise UsageError("There are no clips to train on; expected a training split with at least one scene.")
    keep_memory()
    fabric = make_fabric(device, config.train)
    fabric.launch()
    try:
        return _train(fabric, source, val_source, config, folder, report, look, tensorboard, build)
    finally:
        leave()


def _train(
    fabric: Fabric,
    source: ClipSource,
    val_source: ClipSource | None,
    config: Configuration,
    folder: Path | None,
    report: Report,
    look: Look,
    tensorboard: bool,
    build: Build,
) -> Trained:
    learner = Learner(fabric, config, build)
    with claimed(folder) if folder and fabric.is_global_zero else nullcontext():
        progress = _resume(learner, folder, config, fabric.world_size) if folder else _Progress()
        record = None
        if folder and fabric.is_global_zero:
            record = Record(folder, config, steps=progress.step, tensorboard=tensorboard)
        run = _Run(fabric, learner, source, val_source, config, progress, record, report, look)
        try:
            with stop_on_signals() if folder else nullcontext(StopRequest()) as request:
                run.go_on(request)
        finally:
            if record:
                record.close()
    return Trained(learner.model.cpu().eval(), config, progress.step, progress.seconds, tuple(progress.curve))


@dataclass
class _Progress:
    """What changes from step to step beside the weights."""

    step: int = 0
    seconds: float = 0.0
    curve: list[CurvePoint] = field(default_factory=list)

    def info(self, processes: int) -> dict[str, Any]:
        curve = [point.plain() for point in self.curve]
        return {"step": self.step, "seconds": self.seconds, "processes": processes, "curve": curve}


@dataclass(eq=False)
class _Run:
    """The loop."""

    fabric: Fabric
    learner: Learner
    source: ClipSource
    val_source: ClipSource | None
    config: Configuration
    progress: _Progress
    record: Record | None
    """Of the first process."""
    report: Report
    look: Look

    def go_on(self, request: StopRequest) -> None:
        """Make the steps that are left."""
        progress, settings = self.progress, self.config.train
        budget, watch = Budget.of(settings), Stopwatch(self.fabric.device, progress.seconds)
        fraction = budget.fraction(progress.step, progress.seconds)
        self._save()
        feed = self._feed()
        while fraction < 1:
            rate = learning_rate(settings, fraction)
            with watch.running():
                learned = self.learner.learn(next(feed), step=progress.step, fraction=fraction, learning_rate=rate)
            progress.step += 1
            progress.seconds = self._agree(watch.seconds)
            before, fraction = fraction, budget.fraction(progress.step, progress.seconds)
            if self.record:
                self.record.log_step(progress.step, progress.seconds, rate, learned)
            if budget.validation_is_due(before, fraction):
                self._validate(fraction)
            if self.fabric.is_global_zero:
                latest = progress.curve[-1] if progress.curve else None
                self.report(Status(progress.step, progress.seconds, fraction, learned.losses, latest))
            if self._agree(float(request.received is not None)):
                self._stop(request)
            if self.record and self.record.save_is_due():
                self._save()
        self._save()

    def _feed(self) -> Any:
        settings, fabric = self.config.train, self.fabric
        frames = min(settings.frames, self.source.frames_of_clip)
        sampling = Sampling(
            clips=len(self.source),
            frames_of_clip=self.source.frames_of_clip,
            frames=frames,
            batch=settings.batch * (settings.frames // frames) * fabric.world_size,
            seed=settings.seed,
        )
        share = Share(fabric.global_rank, fabric.world_size)
        readers = readers_for(fabric.device)
        return batches(
            self.source, sampling, share, first_step=self.progress.step, readers=readers, sees=self.learner.model.sees
        )

    def _agree(self, value: float) -> float:
        """The mean over all processes, so that they do the same."""
        return mean_over_processes(self.fabric, torch.tensor([value], dtype=torch.float64)).item()

    def _validate(self, fraction: float) -> None:
        """In the first process; the others wait for it in their next step."""
        if not self.fabric.is_global_zero:
            return
        progress, model, device = self.progress, self.learner.model, self.fabric.device
        if self.val_source is not None and len(self.val_source):
            point = validate(
                model,
                self.val_source,
                self.config.train,
                step=progress.step,
                fraction=fraction,
                seconds=progress.seconds,
                device=device,
                score=_ari_fg,
            )
            check_validation(point.losses, step=progress.step)
            progress.curve.append(point)
            if self.record:
                self.record.log_validation(point)
        model.eval()
        try:
            self.look(model, progress.step, progress.seconds)
        finally:
            model.train()
        if self.record:
            self.record.draw(model, self.val_source or self.source, step=progress.step, device=device)

    def _save(self) -> None:
        if self.record:
            self.record.save(self.learner, self.progress.info(self.fabric.world_size))

    def _stop(self, request: StopRequest) -> None:
        self._save()
        self.fabric.barrier()
        cause = request.received.name if request.received else "a signal to another process"
        raise Interrupted(
            f"Stopped by {cause} after step {self.progress.step}; it is saved, and the same command goes on from there."
        )


def _resume(learner: Learner, folder: Path, config: Configuration, processes: int) -> _Progress:
    state = load_training(folder, config)
    if state is None:
        return _Progress()
    try:
        began, progress = _how_far(state.info)
    except (AttributeError, KeyError, TypeError, ValueError):
        raise CorruptFile(f"{folder / TRAINING} does not say how far it came; begin anew with another --out.") from None
    if progress.step and not state.optimizer and not config.train.skip:
        raise CorruptFile(f"{folder / TRAINING} lacks the state of the optimiser; begin anew with another --out.")
    if began != processes:
        raise UsageError(
            f"{folder} holds a run of {counted(began, 'process', 'processes')}, this is one of {processes}; "
            "start as many, or give another --out."
        )
    learner.restore(state)
    return progress


def _how_far(info: dict[str, Any]) -> tuple[int, _Progress]:
    """Number of processes, and the progress of the training that they made.

    Raises:
        AttributeError, KeyError, TypeError, ValueError: it does not say, or something impossible.
    """
    processes, step, seconds = info["processes"], info["step"], info["seconds"]
    if type(processes) is not int or type(step) is not int or type(seconds) not in (int, float):
        raise TypeError
    if processes < 1 or step < 0 or not 0 <= seconds < math.inf:
        raise ValueError
    return processes, _Progress(step, float(seconds), [CurvePoint.from_plain(point) for point in info["curve"]])


def _ari_fg(truth: Labels, labels: Labels) -> float:
    frames = clip_scores(truth, labels)["ari_fg"]
    defined = frames[~np.isnan(frames)]
    return float(defined.mean()) if len(defined) else float("nan")
