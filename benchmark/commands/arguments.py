"""Flags of the command line, one class per command."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

Task = Literal["segmentation", "editing"]
Switch = Annotated[bool, tyro.conf.FlagCreatePairsOff]
DEFAULT_OUT = Path("results")


@dataclass(frozen=True)
class Run:
    """Compare models; the same command again makes only the rows that are missing."""

    model: tuple[str, ...] = ()
    """Names of models and groups, such as training-free or paper; the latter sets an equal budget of 12 minutes."""
    track: tuple[str, ...] = ()
    """Names of tracks and groups, such as paper; moving if left out. Their datasets are generated on first use. Track
    real-table takes the dataset of --data, and segments what stands on its tables as obpose-segment does."""
    task: Task = "segmentation"
    """`editing` compares removed, moved and copied objects of inferred scenes with ground truth; it needs --pretrained
    or --checkpoint. See docs/benchmark.md."""
    scenes: int | None = None
    """Number of test scenes whose edits are scored, from the first on; all if left out."""
    refine: int = 0
    """Number of steps that fit inferred scenes to their frames before editing; obpose-edit infer uses 100. 0: score
    scenes as inferred."""
    profile: Literal["cpu", "gpu"] = "cpu"
    """Size of the tracks' images and of the learned models' networks, for a CPU core or a GPU."""
    slots: tuple[int, ...] = ()
    """Numbers of slots for objects, without the background. Each number N other than the track's largest object count,
    the default, makes a separate model NAME-N-slots."""
    data: Path | None = None
    """Folder of a dataset, in place of tracks."""
    predictions: tuple[Path, ...] = ()
    """Folders of label maps to score in place of models, one per seed; see docs/benchmark.md."""
    name: str | None = None
    """Name of the predictions, or of the one --checkpoint, in the tables; the first folder's name if left out."""
    background_slot: int | None = None
    """Background label of predictions that do not declare one; the most frequent label of each clip if left out."""
    seeds: int = 3
    """Number of runs, with seeds 0, 1, ..."""
    fit_track: str | None = None
    """Fit or tune once on this track, and score on all tracks; if left out, fit on each track."""
    out: Path = DEFAULT_OUT
    """The run folder."""
    list: Switch = False
    """List models and tracks, then exit."""
    pretrained: Switch = False
    """Use weights that ship with the package, in place of training."""
    checkpoint: tuple[Path, ...] = ()
    """Folders made by obpose-train, to be scored beside models. If they were trained on another track than the scored
    one, name it with --fit-track."""
    budget: float | None = None
    """Training budget of learned models, in seconds of one core; if left out, that of the group paper, or each model's
    own."""
    steps: int | None = None
    """Training budget of learned models in steps, in place of seconds."""
    deterministic: Switch = False
    """Use one thread and budgets in steps, so that all runs give equal tables, except for the columns measured_*."""
    workers: int = 2
    """Number of jobs that run in parallel."""
    dask: str | None = None
    """Address of a Dask scheduler, tcp://HOST:PORT, whose workers run the jobs; see docs/cluster.md."""
    time_limit: float | None = None
    """Minutes after which a row fails; if left out, an hour plus twice the training time."""
    memory_limit: float | None = None
    """Memory in MiB beyond which a row fails; if left out, an equal share of 90 % of the machine's memory."""
    overwrite: Switch = False
    """Replace rows of the same model, track and seed that have other settings or versions."""
    retry: Switch = False
    """Run failed jobs again; predictions are always tried again."""


@dataclass(frozen=True)
class Rescore:
    """Recompute all scores from stored label maps, and write tables and report; no model runs."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    data: tuple[Path, ...] = ()
    """Folders of datasets that the runs were scored on, if they were moved."""


@dataclass(frozen=True)
class Compare:
    """Compare two models scene by scene on all tracks that both have scores on; needs rows only."""

    one: Annotated[str, tyro.conf.Positional]
    """Name of a model."""
    other: Annotated[str, tyro.conf.Positional]
    """Name of the other model."""
    run: Path = DEFAULT_OUT
    """Run folder with the results of both, such as docs/results."""
    fit_track: str | None = None
    """Compare the first model, fitted on this track, with the other one fitted on each track that is scored. Default:
    both were fitted on the same track."""


@dataclass(frozen=True)
class Report:
    """Write tables and report of a run folder again."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    data: tuple[Path, ...] = ()
    """Folders of datasets that the runs were scored on, if they were moved."""


@dataclass(frozen=True)
class Pack:
    """Add the rows of run folders to a folder of compressed results for publication, without label maps.

    `compare` and `report` read such a folder like a run folder. Results stored in another packed folder of the same
    tree become references.
    """

    run: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run folders, or packed ones."""
    out: Path
    """The packed folder, such as docs/results/paper; created if missing. Its results are never replaced; its tables are
    written again."""


@dataclass(frozen=True)
class Selftest:
    """Check the metrics against golden cases scored by reference implementations."""
