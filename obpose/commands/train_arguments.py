"""Flags of `obpose-train`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]


@dataclass(frozen=True)
class Train:
    """Train a model without labels; the same command again goes on where it was stopped."""

    track: str | None = None
    """Name of a track of obpose-bench; its dataset is made on first use."""
    data: Path | None = None
    """Folder of a dataset, in the place of a track."""
    variant: str = "obpose"
    """What the model is; see obpose/systems.py."""
    profile: str = "cpu"
    """How large it is, and the track's images: cpu, gpu or paper."""
    minutes: float | None = None
    """Budget in minutes of CPU time (on a GPU: of time of day), the profile's if left out; validating, drawing and
    saving do not count."""
    steps: int | None = None
    """Budget in steps, in the place of minutes."""
    seed: int = 0
    """Of weights, order of clips, and noise."""
    out: Path | None = None
    """The run's folder; default runs/VARIANT-PROFILE-DATA-seedS."""
    set: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """Any other value of the model's configuration, such as model.pose.box_size=0.3; can be given many times."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """`auto`: a GPU if there is one."""
    threads: int = 1
    """Of a CPU; two runs side by side get further than one with two."""
    workers: int = 2
    """Processes that make the track's dataset."""
    tensorboard: Switch = False
    """Also write curves for TensorBoard; pip install 'obpose[tensorboard]'."""
