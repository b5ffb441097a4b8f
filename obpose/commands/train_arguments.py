"""Flags of `obpose-train`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]


@dataclass(frozen=True)
class Train:
    """Train a model without labels; the same command resumes a stopped run."""

    track: str | None = None
    """Name of a track of obpose-bench; its dataset is made on first use."""
    data: Path | None = None
    """Folder of a dataset, instead of a track."""
    variant: str = "obpose"
    """Name of the system; obpose/systems.py lists them."""
    profile: str = "cpu"
    """Size of the model and of the track's images: cpu, gpu or paper."""
    minutes: float | None = None
    """Budget in minutes of CPU time (wall time on a GPU), by default the profile's. Validating, drawing and saving do
    not count."""
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
