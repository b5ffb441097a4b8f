"""Training: from clips without labels and a configuration to a model (paper, section Training).

    trained = train(SceneDataset(folder), SceneDataset(folder, "val"), config, folder=Path("runs/one"))

The clips and the noise of a step depend only on the seed and the number of the step, so that a stopped run resumes
exactly. With a budget in minutes the learning rate depends on measured time, which varies between runs. With a budget
in steps the weights are reproducible to the last bit.
"""

import math
from collections.abc import Callable
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from lightning_fabric import Fabric

from datagen.console.text import counted
from datagen.storage.atomic import locked_folder
from obpose.data.clips import ClipSource
from obpose.errors import CorruptFile, Interrupted, UsageError
from obpose.storage.checkpoint import TRAINING, Build, load_training
from obpose.systems import build_model
from obpose.trainable import Configuration, Trainable
from obpose.training.batches import Sampling, Share, batches, readers_for
from obpose.training.budget import Budget, Stopwatch, learning_rate
from obpose.training.devices import keep_memory, make_fabric, mean_over_processes, process_group
from obpose.training.guard import check_validation
from obpose.training.learner import Learner
from obpose.training.record import SAVE_SECONDS, Record
from obpose.training.signals import StopRequest, stop_on_signals
from obpose.training.validation import CurvePoint, Score, validate

__all__ = ["CurvePoint", "Status", "Trained", "train"]


@dataclass(frozen=True)
class Status:
    """Progress of a training."""

    step: int
    """Number of finished steps."""
    seconds: float
    """Time spent in training steps, as counted by the budget: CPU time of this process, on a GPU wall time."""
    fraction: float
    """Share of the budget that is used, 0 to 1."""
    losses: dict[str, float]
    """Losses of the last step, by name."""
    validation: CurvePoint | None
    """Result of the latest validation."""


Report = Callable[[Status], None]
"""Callback that gets the status after each step."""


@dataclass(frozen=True, eq=False)
class Trained:
    """Result of a training."""

    model: Trainable
    """The trained model, on the CPU and in evaluation mode."""
    config: Configuration
    steps: int
    seconds: float
    """Time spent in training steps, as counted by the budget."""
    curve: tuple[CurvePoint, ...]
    """Validation results, for inspection only."""


Look = Callable[[Trainable, int, float], None]
"""Callback at each validation; it gets the model in evaluation mode, the finished steps and the seconds."""


def train(
    source: ClipSource,
    val_source: ClipSource | None,
    config: Configuration,
    *,
    folder: Path | None = None,
    report: Report = lambda status: None,
    look: Look = lambda model, step, seconds: None,
    score: Score | None = None,
    device: str = "auto",
    tensorboard: bool = False,
    save_seconds: float = SAVE_SECONDS,
    build: Build = build_model,
) -> Trained:
    """Train a model until its budget, `config.train.minutes` or `.steps`, is used up.

    Args:
        source: Clips to learn from.
        val_source: Clips for validation losses, and for scores if they have labels; only shown and logged.
        config: All settings, with the statistics of the scene (`obpose.data.scene_stats.measure_scene`).
        folder: Folder for checkpoints, curves and pictures, from which a stopped run resumes; None to save nothing.
        report: Callback that gets the status after each step.
        look: Callback that gets the model at each validation; it affects neither the result nor the budget.
        score: ARI-FG from the true and the predicted labels of a clip; None to log losses only.
        device: `auto` (a GPU if there is one), `cpu` or `cuda`.
        tensorboard: Whether to also write curves for TensorBoard.
        save_seconds: Wall time between two checkpoints in `folder`.
        build: Builds the model; by default the architecture that the configuration belongs to.

    Raises:
        UsageError: there are no clips, or the folder holds a run of another configuration or is in use.
        CorruptFile: the checkpoint in the folder is damaged.
        Diverged: losses or gradients are not finite.
        Interrupted: SIGTERM or SIGINT was received; the state is saved.
    """
    if not len(source):
        raise UsageError("There are no clips to train on; expected a training split with at least one scene.")
    keep_memory()
    fabric = make_fabric(device, config.train)
    fabric.launch()
    writes = folder is not None and fabric.is_global_zero
    with (
        process_group(),
        closing(Learner(fabric, config, build)) as learner,
        locked_folder(folder) if folder and writes else nullcontext(),
    ):
        progress = _resume(learner, folder, config, fabric.world_size) if folder else _Progress()
        # Otherwise a slow process would find the files that the first one writes.
        fabric.barrier()
        record = (
            Record(folder, config, steps=progress.step, tensorboard=tensorboard, save_seconds=save_seconds)
            if folder and writes
            else None
        )
        clips = learner.model.training_source(source)
        learner.model.check_source(clips)
        val_clips = None
        if val_source is not None and len(val_source) and fabric.is_global_zero:
            val_clips = learner.model.training_source(val_source)
        run = _Run(fabric, learner, clips, val_source, val_clips, config, progress, record, report, look, score)
        try:
            with stop_on_signals() if folder else nullcontext(StopRequest()) as request:
                run.go_on(request)
        finally:
            if record:
                record.close()
    return Trained(learner.model.cpu().eval(), config, progress.step, progress.seconds, tuple(progress.curve))


@dataclass
class _Progress:
    """State of the loop that changes with each step, apart from weights and optimiser."""

    step: int = 0
    seconds: float = 0.0
    curve: list[CurvePoint] = field(default_factory=list)

    def info(self, processes: int) -> dict[str, Any]:
        curve = [point.plain() for point in self.curve]
        return {"step": self.step, "seconds": self.seconds, "processes": processes, "curve": curve}


@dataclass(eq=False)
class _Run:
    """The training loop."""

    fabric: Fabric
    learner: Learner
    source: ClipSource
    val_source: ClipSource | None
    """Clips for scores and pictures."""
    val_clips: ClipSource | None
    """`Trainable.training_source` of these clips, for losses; None in all processes but the first."""
    config: Configuration
    progress: _Progress
    record: Record | None
    """Files of the run; only in the first process."""
    report: Report
    look: Look
    score: Score | None

    def go_on(self, request: StopRequest) -> None:
        """Run the remaining steps."""
        progress, settings = self.progress, self.config.train
        budget, watch = Budget.of(settings), Stopwatch(self.fabric.device, progress.seconds)
        fraction = budget.fraction(progress.step, progress.seconds)
        self._change_sources(fraction)
        self._save()
        feed = self._feed() if fraction < 1 else iter(())
        while fraction < 1:
            # One step; its time counts towards the budget.
            rate = learning_rate(settings, fraction)
            with watch.running():
                result = self.learner.step(next(feed), step=progress.step, fraction=fraction, learning_rate=rate)
            progress.step += 1
            progress.seconds = self._agree(watch.seconds)
            before, fraction = fraction, budget.fraction(progress.step, progress.seconds)
            if fraction < 1 and self._change_sources(fraction):
                feed = self._feed()
            # Logs, validation and progress.
            if self.record:
                self.record.log_step(progress.step, progress.seconds, rate, result)
            if budget.validation_is_due(before, fraction):
                self._validate(fraction)
            if self.fabric.is_global_zero:
                latest = progress.curve[-1] if progress.curve else None
                self.report(Status(progress.step, progress.seconds, fraction, result.losses, latest))
            # Stop in all processes together, or save.
            if self._agree(float(request.received is not None)):
                self._stop(request)
            if self.record and self.record.save_is_due():
                self._save()
        self._save()

    def _change_sources(self, fraction: float) -> bool:
        """Let the model change the training data, before the next step and checkpoint; tell whether it did."""
        model, before = self.learner.model, self.source
        self.source = model.next_source(before, fraction)
        if self.val_clips is not None:
            self.val_clips = model.next_source(self.val_clips, fraction)
        return self.source is not before

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
            self.source,
            sampling,
            share,
            first_step=self.progress.step,
            readers=readers,
            kind=self.learner.model.observation_type,
        )

    def _agree(self, value: float) -> float:
        """Mean of a value over all processes, so that all take the same decisions."""
        return mean_over_processes(self.fabric, torch.tensor([value], dtype=torch.float64)).item()

    def _validate(self, fraction: float) -> None:
        """Validate in the first process; the others wait for it in their next step."""
        if not self.fabric.is_global_zero:
            return
        progress, model, device = self.progress, self.learner.model, self.fabric.device
        # Losses and score on the validation clips.
        if self.val_source is not None and self.val_clips is not None:
            point = validate(
                model,
                self.val_source,
                self.val_clips,
                self.config.train,
                step=progress.step,
                fraction=fraction,
                seconds=progress.seconds,
                device=device,
                score=self.score,
            )
            check_validation(point.losses, step=progress.step)
            progress.curve.append(point)
            if self.record:
                self.record.log_validation(point)
        # Observers of the model, and pictures.
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
    if progress.step and not state.optimizer:
        raise CorruptFile(f"{folder / TRAINING} lacks the state of the optimiser; begin anew with another --out.")
    if began != processes:
        raise UsageError(
            f"{folder} holds a run of {counted(began, 'process', 'processes')}, this is one of {processes}; "
            "start as many, or give another --out."
        )
    learner.restore(state)
    return progress


def _how_far(info: dict[str, Any]) -> tuple[int, _Progress]:
    """Read the number of processes and the progress from a checkpoint's info.

    Raises:
        AttributeError, KeyError, TypeError, ValueError: values are missing or impossible.
    """
    processes, step, seconds = info["processes"], info["step"], info["seconds"]
    if type(processes) is not int or type(step) is not int or type(seconds) not in (int, float):
        raise TypeError
    if processes < 1 or step < 0 or not 0 <= seconds < math.inf:
        raise ValueError
    return processes, _Progress(step, float(seconds), [CurvePoint.from_plain(point) for point in info["curve"]])
