"""The command `obpose-train`: train a model on a track or on a dataset of your own.

obpose-train --track moving                                    24 minutes of one CPU core
obpose-train --data DIR --variant obpose-loc --minutes 6
obpose-train --track moving --set model.pose.box_size=0.3
torchrun --nproc-per-node 2 -m benchmark.commands.train --track moving       two processes, each with a batch of its own
"""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from datagen.console.command_line import Command, run_command
from datagen.console.interrupts import interruptible_imports
from datagen.console.progress import status_console, track_progress
from datagen.console.text import counted
from obpose.config_bounds import MOST_MINUTES, MOST_STEPS
from obpose.config_text import parse_changes
from obpose.errors import EXIT_OK, UsageError, unknown_name
from obpose.systems import System, find_system, slots_for

if TYPE_CHECKING:
    from datagen.tracks import DataFolder, Track
    from obpose.training.validation import Score

Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]


@dataclass(frozen=True)
class Train:
    """Train a model without labels; the same command resumes a stopped run."""

    track: str | None = None
    """Name of a track of obpose-bench; its dataset is made on first use."""
    data: Path | None = None
    """Folder of a dataset, instead of a track."""
    variant: str = "obpose-contact"
    """Name of the system; obpose/systems.py lists them."""
    profile: str = "cpu"
    """Size of the model and of the track's images: cpu, gpu or paper."""
    minutes: float | None = None
    """Budget in minutes of CPU time (wall time on a GPU), by default that of the system: 24 for obpose-contact.
    Validating, drawing and saving do not count."""
    steps: int | None = None
    """Budget in steps, instead of minutes."""
    seed: int = 0
    """Seed of weights, order of clips, and noise."""
    out: Path | None = None
    """The run's folder; default runs/VARIANT-PROFILE-DATA-seedS."""
    set: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Any other value of the model's configuration, such as model.pose.box_size=0.3; can be given many times."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """`auto`: a GPU if there is one."""
    threads: int = 1
    """CPU threads; two runs with one thread each are faster than one run with two."""
    workers: int = 2
    """Processes that make the track's dataset."""
    tensorboard: Switch = False
    """Also write curves for TensorBoard; pip install 'obpose[tensorboard]'."""


PROGRAM = "obpose-train"
RUNS = Path("runs")
LIMITS = {"minutes": MOST_MINUTES, "steps": MOST_STEPS, "threads": 1024, "workers": 1024}
"""Largest values of flags, all of which are positive."""
MOST_PIXELS = 160 * 120
"""Pixels of an image beyond which systems that group pixels are slow, above all while they are untrained."""
GROUPING = ("obpose-contact", "contact", "supervised", "ogc")
"""Architectures that group the pixels of whole images."""


def main(arguments: Sequence[str] | None = None, *, score: "Score | None" = None) -> int:
    """Train and return the exit code; `score` is logged at each validation, see `benchmark.commands.train`."""
    return run_command(
        PROGRAM,
        Command(Train, lambda values: run(values, score)),
        description=__doc__,
        arguments=arguments,
        interrupted="Interrupted; the same command goes on from the last checkpoint.",
        out_of_memory="Out of memory; give smaller --set train.batch, train.frames or train.rays.",
    )


def run(values: Train, score: "Score | None" = None) -> int:
    """Prepare the data, train, and say where everything is."""
    # Late, because --help and wrong flags need no NumPy.
    with interruptible_imports(PROGRAM):
        from datagen.storage.atomic import check_no_dataset, locked_folder
        from datagen.storage.reader import Dataset
        from datagen.tracks import DataFolder, find_track

    system = find_system(values.variant)
    _check(values, system)
    changes = parse_changes(values.set, system.architecture.config)
    if (values.track is None) == (values.data is None):
        raise UsageError("Say what to train on: either --track NAME or --data DIR.")
    size = "cpu" if values.profile == "cpu" else "gpu"
    data = DataFolder(values.data) if values.data is not None else find_track(str(values.track), size)
    if not data.size("train"):
        raise UsageError(
            f"{values.data} has no training scenes; expected at least one. Make a dataset with some, such as with "
            "obpose-datagen --split train=2000,val=100,test=300."
        )
    if data.slots < 2:
        raise UsageError(
            f"{values.data} has no objects, only the background; expected scenes with objects to learn. Make a dataset "
            "with --objects.maximum 1 or more."
        )
    out = values.out or RUNS / f"{values.variant}-{values.profile}-{data.name}-seed{values.seed}"
    check_no_dataset(out)
    console = status_console(quiet=_process() > 0)
    folder = _prepare(data, values, console)

    # Late, because PyTorch takes seconds to import.
    with interruptible_imports(PROGRAM):
        import torch

        from obpose.commands.train_progress import progress_bar
        from obpose.data.datasets import SceneDataset
        from obpose.data.scene_stats import measure_scene
        from obpose.training.loop import train

    torch.set_num_threads(values.threads)
    source = SceneDataset(folder, extra=["segmentation"] if system.uses_labels else ())
    labels = [name for name in ("segmentation",) if name in Dataset(folder).fields("val")]
    val_source = SceneDataset(folder, "val", extra=labels) if data.size("val") else None
    measured = system.known(measure_scene(source).changes())
    # Changes that follow from the track and the flags, from the scenes, and those that --set gives.
    chosen = {
        **system.changes_on(values.track or ""),
        **system.known(slots_for(data.slots)),
        "train.seed": values.seed,
    }
    chosen |= {"train.steps": values.steps} | ({} if values.minutes is None else {"train.minutes": values.minutes})
    config = system.config(values.profile, chosen | measured | changes)
    system.architecture.check(config)
    if _process() == 0:  # fails before the announcement if the folder cannot be written
        with locked_folder(out), TemporaryFile(dir=out):
            pass
    minutes, steps = config.train.minutes, config.train.steps
    if system.architecture.name in GROUPING:
        _warn_of_large_images(console, data.resolution)
    budget = counted(minutes, "minute") if steps is None else counted(steps, "step")
    console.print(f"Training {values.variant} on {data.name}, {budget}, into {out}", markup=False)
    with progress_bar(console) as report:
        trained = train(
            source,
            val_source,
            config,
            folder=out,
            report=report,
            score=score,
            device=values.device,
            tensorboard=values.tensorboard,
        )
    if _process() == 0:
        print(f"{out.resolve()}: {counted(trained.steps, 'step')} in {trained.seconds / 60:.1f} minutes.")
    return EXIT_OK


def _check(values: Train, system: System) -> None:
    if values.profile not in (profiles := system.architecture.profiles):
        raise unknown_name("profile", values.profile, profiles)
    if values.minutes is not None and values.steps is not None:
        raise UsageError("--minutes and --steps contradict each other; leave one of them out.")
    for name, most in LIMITS.items():
        value = getattr(values, name)
        if value is not None and not 0 < value <= most:
            raise UsageError(f"--{name} {value}: expected more than 0 and at most {most}.")
    if not 0 <= values.seed < 2**63:
        raise UsageError(f"--seed {values.seed}: expected 0 or more, and less than 2^63.")


def _warn_of_large_images(console: Console, size: tuple[int, int]) -> None:
    width, height = size
    if width * height > MOST_PIXELS:
        console.print(
            f"Warning: images have {width}x{height} pixels, expected at most 160x120. Each validation and picture may "
            "take many minutes. Make smaller images: obpose-datagen import (for recordings) and "
            "obpose-datagen render --from (for generated scenes) have --resolution 160x120.",
            markup=False,
            highlight=False,
        )


def _prepare(data: "Track | DataFolder", values: Train, console: Console) -> Path:
    """Prepare the dataset and give its folder. The first process makes it, the others wait until it is complete."""
    splits = [split for split in ("train", "val") if data.size(split)]
    while _process() > 0 and data.missing(splits):
        time.sleep(1.0)
    return data.prepare(
        splits, workers=values.workers, progress=partial(track_progress, console, data.name, data.folder)
    )


def _process() -> int:
    """Number of this process among those that `torchrun` started."""
    return int(os.environ.get("RANK", 0))
