"""One job: fit a model once, then segment, store and score one or more tracks; all in the calling process."""

import math
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from benchmark.clips import ClipSequence, TruthSequence
from benchmark.interface import Clip, Segmenter
from benchmark.model_spec import ModelSpec, Options
from benchmark.registry import find_model
from benchmark.results import LABELS, Measured, RunKey, RunRow, save_row
from benchmark.scoring import score_labels, segment_split
from benchmark.tuning import choose
from datagen.errors import UsageError
from datagen.storage import Dataset, Split

SPLIT = "test"
"""The split that is scored."""


@dataclass(frozen=True)
class Target:
    """One row to be made."""

    key: RunKey
    data: Path
    """Dataset to score on."""
    slots: int
    """Slots that the model may use there."""


@dataclass(frozen=True)
class Job:
    """A model and a seed: fitted once, scored on every target."""

    model: str
    seed: int
    fit_data: Path
    fit_slots: int
    targets: tuple[Target, ...]
    out: Path
    """The run folder."""
    seconds: float = math.inf
    """That the model may train for."""
    steps: int | None = None
    """That it trains for, where budgets are counted in steps."""


def run_job(job: Job, announce: Callable[[str], None] = lambda event: None) -> None:
    """Make all rows of a job; `announce` hears "fitted", and the name of every row when it is written.

    Raises:
        UsageError: the model, a dataset or a split does not exist, or a split is empty.
        BadPrediction: the model returned something else than labels for every pixel.
        CorruptFile: a dataset is damaged.
    """
    spec = find_model(job.model)
    fitted = _fit(spec, job)
    announce("fitted")
    for target in job.targets:
        _make_row(spec, job, fitted, target)
        announce(target.key.name)


@dataclass(frozen=True)
class _Fitted:
    """What fitting found out; models that learn nothing are built anew for the slots of every target."""

    segmenter: Segmenter
    options: Options
    tuned: bool
    seconds: float


def _fit(spec: ModelSpec, job: Job) -> _Fitted:
    started = time.perf_counter()
    dataset = Dataset(job.fit_data)
    # Only models that learn get training clips, so that the others do not wait for these to be made.
    train: Sequence[Clip] = _clips(dataset.split("train"), spec) if spec.kind == "learned" else []
    val = _clips(dataset.split("val"), spec)
    options = {"slots": job.fit_slots} | ({} if job.steps is None else {"steps": job.steps})
    truths = TruthSequence(dataset.split("val"))
    if len(spec.grid) > 1 and not len(val):
        raise UsageError(f"{job.fit_data} has no validation scenes, but {job.model!r} is tuned on them; make some.")
    choice = choose(spec, options, train, val, truths, seed=job.seed, budget=job.seconds)
    left = job.seconds - (time.perf_counter() - started) if choice.scores else job.seconds
    segmenter = spec.build(choice.options)
    segmenter.fit(train, val, seed=job.seed, budget=max(left, 0.0))
    return _Fitted(segmenter, choice.options, bool(choice.scores), time.perf_counter() - started)


def _clips(scenes: Split, spec: ModelSpec) -> ClipSequence:
    return ClipSequence(scenes, uses_labels=spec.uses_labels)


def _make_row(spec: ModelSpec, job: Job, fitted: _Fitted, target: Target) -> None:
    scenes = Dataset(target.data).split(SPLIT)
    if len(scenes) == 0:
        raise UsageError(f"Split {SPLIT!r} of {target.data} has no scenes; generate some.")
    segmenter, options = _for_target(spec, job, fitted, target)
    labels = job.out / LABELS / f"{target.key.name}.h5"
    seconds = segment_split(lambda _, clip: segmenter.segment(clip), _clips(scenes, spec), labels, target.data)
    frames = score_labels(labels, scenes, job.out, target.key.name)
    row = RunRow(
        key=target.key,
        status="ok",
        reason="",
        config=dict(options),
        tuned=fitted.tuned,
        uses_labels=spec.uses_labels,
        kind=spec.kind,
        priors=spec.priors,
        random=spec.random,
        n_scenes=len(scenes),
        parameters=int(getattr(segmenter, "parameters", 0)),
        device=str(getattr(segmenter, "device", "cpu")),
        commit=commit(),
        measured=Measured(seconds / frames, fitted.seconds, peak_mib()),
        learning_curve=getattr(segmenter, "learning_curve", None),
    )
    save_row(job.out, row)


def _for_target(spec: ModelSpec, job: Job, fitted: _Fitted, target: Target) -> tuple[Segmenter, Options]:
    if spec.kind == "learned" or target.slots == job.fit_slots:
        return fitted.segmenter, fitted.options
    options = {**fitted.options, "slots": target.slots}
    segmenter = spec.build(options)
    segmenter.fit([], _clips(Dataset(job.fit_data).split("val"), spec), seed=job.seed, budget=job.seconds)
    return segmenter, options


def peak_mib() -> float:
    """Largest resident memory that this process ever had, MiB."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


@cache
def commit() -> str:
    """The commit of the code, with a plus sign where files were changed since; empty outside a git checkout."""
    root = Path(__file__).parent.parent

    def git(*arguments: str) -> str:
        found = subprocess.run(["git", "-C", root, *arguments], capture_output=True, text=True, check=False)
        return found.stdout.strip() if found.returncode == 0 else ""

    if not (root / ".git").exists():
        return ""
    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "--", "benchmark", "datagen", "obpose")
        return git("rev-parse", "--short=12", "HEAD") + ("+" if changed else "")
    except OSError:
        return ""
