"""Flags of the command line, one class a command."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from datagen.tracks import Profile

Task = Literal["segmentation", "editing"]
Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
DEFAULT_OUT = Path("results")


@dataclass(frozen=True)
class Run:
    """Compare models; the same command again makes only the rows that are missing."""

    model: tuple[str, ...] = ()
    """Names of models and groups, such as training-free or paper; the latter sets an equal budget of 12 minutes."""
    track: tuple[str, ...] = ()
    """Names of tracks and groups, such as paper; moving if left out. Their datasets are made on first use."""
    task: Task = "segmentation"
    """`editing` scores removed, moved and copied objects of inferred scenes against the generator's, with --pretrained
    or --checkpoint; docs/benchmark.md says how."""
    scenes: int | None = None
    """Test scenes whose edits are scored, from the first on; all if left out."""
    refine: int = 0
    """Steps in which inferred scenes are fitted to their frames before they are edited; obpose-edit infer takes 100.
    With 0 codes alone are scored."""
    profile: Profile = "cpu"
    """Size of the tracks' images, and of the networks of models that learn: for a CPU core, or for a GPU."""
    slots: tuple[int, ...] = ()
    """Slots for objects, the background's comes on top: a model for each number, NAME-N-slots unless N is the track's
    largest object count, which it has if this is left out."""
    data: Path | None = None
    """Folder of a dataset, in place of tracks."""
    predictions: tuple[Path, ...] = ()
    """Folders of label maps to score in the place of models, one a seed; see docs/benchmark.md."""
    name: str | None = None
    """Name of the predictions, or of the one --checkpoint, in the tables; the first folder's name if left out."""
    background_slot: int | None = None
    """Background label of predictions that do not say; the most frequent label of each clip if left out."""
    seeds: int = 3
    """Number of runs; their seeds are 0, 1, ..."""
    fit_track: str | None = None
    """Fit, or tune, once on this track, for all tracks; each on itself if left out."""
    out: Path = DEFAULT_OUT
    """The run folder."""
    list: Switch = False
    """List models and tracks, then exit."""
    pretrained: Switch = False
    """Models that learn use weights that ship with the package, in the place of training."""
    checkpoint: tuple[Path, ...] = ()
    """Folders that obpose-train made, to be scored beside models; name the track that they were trained on with
    --fit-track, if it is not the one that they are scored on."""
    budget: float | None = None
    """Seconds of one core that a model that learns may train for; if left out, those of the group paper, or what each
    declares."""
    steps: int | None = None
    """Training steps of a model that learns, in place of seconds."""
    deterministic: Switch = False
    """Use one thread and budgets in steps: every run gives equal tables, except for the columns measured_*."""
    workers: int = 2
    """Number of jobs that run in parallel."""
    time_limit: float | None = None
    """Minutes after which a row has failed; if left out, an hour and twice the time that its model may train for."""
    memory_limit: float | None = None
    """MiB of memory at which a row has failed; if left out, an equal part of nine tenths of the machine's."""
    overwrite: Switch = False
    """Replace rows of the same model, track and seed that were made with other settings or versions."""
    retry: Switch = False
    """Run failed jobs again; predictions are always tried again."""


@dataclass(frozen=True)
class Rescore:
    """Compute all scores anew from stored label maps, and write tables and report; no model runs."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    data: tuple[Path, ...] = ()
    """Folders of datasets that the runs were scored on, if they are not where they were."""


@dataclass(frozen=True)
class Compare:
    """Paired differences of two models, scene by scene, on all tracks that both have scores on; needs rows only."""

    one: Annotated[str, tyro.conf.Positional]
    """Name of a model."""
    other: Annotated[str, tyro.conf.Positional]
    """Name of the other model."""
    run: Path = DEFAULT_OUT
    """Run folder with the results of both, such as docs/results."""


@dataclass(frozen=True)
class Report:
    """Write tables and report of a run folder again."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    data: tuple[Path, ...] = ()
    """Folders of datasets that the runs were scored on, if they are not where they were."""


@dataclass(frozen=True)
class Pack:
    """Add the rows of run folders to a folder of compressed results, to be published; label maps are left out.

    `compare` and `report` read such a folder like a run folder. Results that another packed folder of the same tree
    holds become references to it.
    """

    run: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run folders, or packed ones."""
    out: Path
    """The packed folder, such as docs/results/paper; made if it is missing. Its results are kept, never replaced; its
    tables are written anew."""


@dataclass(frozen=True)
class Selftest:
    """Check the metrics against golden cases that reference implementations scored."""
