"""One job: fit a model once, then segment, store and score one or more tracks; all in the calling process."""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.clips import ClipSequence, TruthSequence
from benchmark.execution.machine import commit, peak_mib
from benchmark.execution.scoring import Predict, score_labels, segment_split
from benchmark.execution.validation_scores import WATCHED, Watch
from benchmark.models.adapters.predictions import PredictionFolder
from benchmark.models.interface import Segmenter
from benchmark.models.model_spec import ModelSpec, Options
from benchmark.models.registry import find_model
from benchmark.models.tuning import choose
from benchmark.ranking.text import brief, one_line
from benchmark.results.curves import Curve
from benchmark.results.run_folder import LABELS, Measured, RunKey, RunRow, save_row
from datagen.errors import UsageError
from datagen.storage.reader import Dataset, Split
from datagen.tracks import Profile

SPLIT = "test"
"""The split that is scored."""


@dataclass(frozen=True)
class Target:
    """A row to be made, with further rows from the same predictions."""

    key: RunKey
    data: Path
    """Dataset to score on."""
    slots: int
    """Number of slots that the model may use on this dataset."""
    extra: Mapping[str, RunKey] = field(default_factory=dict)
    """Rows of the segmentations in `Prediction.extra`, by their names."""

    @property
    def keys(self) -> tuple[RunKey, ...]:
        """Keys of all rows of the target."""
        return self.key, *self.extra.values()


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
    """Training budget in seconds; a tuned model spends half of it on tuning."""
    steps: int | None = None
    """Training budget in steps, in place of seconds."""
    folder: Path | None = None
    """Folder for the model's own files; see `benchmark.models.interface`."""
    checkpoint: Path | None = None
    """Trained weights, used in place of training."""
    profile: Profile = "cpu"
    """Size of the networks of a model that learns."""

    @property
    def learns(self) -> bool:
        """Whether the model is one that learns, in this job or elsewhere."""
        return self.folder is not None or self.checkpoint is not None

    @property
    def pretrained(self) -> str:
        """Name of the trained weights; empty if there are none."""
        return self.checkpoint.name if self.checkpoint else ""

    predictions: PredictionFolder | None = None
    """Label maps to score in place of a model."""

    @property
    def trains(self) -> bool:
        """Whether the model is trained in this job."""
        return self.learns and not self.checkpoint

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the targets' own rows."""
        return tuple(target.key.name for target in self.targets)

    def run(self, announce: Callable[[str], None]) -> None:
        """Make all rows of the job; see `run_job`."""
        run_job(self, announce)


def run_job(job: Job, announce: Callable[[str], None] = lambda event: None) -> None:
    """Make all rows of a job. Calls `announce` with "fitted", then with each target's row name once it is written.

    Raises:
        UsageError: the model, a dataset or a split does not exist, or a split is empty.
        BadPrediction: the model did not return a label for every pixel.
        CorruptFile: a dataset is damaged.
    """
    fitted = None if job.predictions else _fit(find_model(job.model), job)
    announce("fitted")
    for target in job.targets:
        rows = [_predictions_row(job, target)] if fitted is None else _model_rows(job, fitted, target)
        # Write the target's own row last: its existence implies that of the others.
        for row in rows[::-1]:
            save_row(job.out, row)
        announce(target.key.name)


def blank_row(key: RunKey, spec: ModelSpec | None, *, status: str, reason: str = "") -> RunRow:
    """Build a row from the facts known before a model runs; without `spec`, a row of label maps made elsewhere."""
    nan = float("nan")
    return RunRow(
        key=key,
        status="ok" if status == "ok" else "failed",
        reason=brief(reason),
        config={},
        tuned=False,
        uses_labels=spec is not None and spec.uses_labels,
        kind=spec.kind if spec else "predictions",
        priors=spec.priors if spec else (),
        random=spec is None or spec.random,
        n_scenes=0,
        parameters=0,
        device="cpu",
        commit=commit(),
        measured=Measured(nan, nan, nan),
    )


@dataclass(frozen=True)
class _Fitted:
    """Result of fitting a model."""

    spec: ModelSpec
    segmenter: Segmenter
    options: Options
    seconds: float
    watch: Watch | None

    @property
    def learning_curve(self) -> Curve | None:
        """Learning curve that the model recorded, with the scores of `watch` added; None if it is empty."""
        curve = getattr(self.segmenter, "learning_curve", None)
        points = [{one_line(str(name)): float(value) for name, value in point.items()} for point in curve or ()]
        return (self.watch.added_to(points) if self.watch else points) or None


def _fit(spec: ModelSpec, job: Job) -> _Fitted:
    started = time.perf_counter()
    if job.checkpoint:
        return _pretrained(spec, job)
    dataset = Dataset(job.fit_data)
    # Only models that learn get training clips, so that other models do not wait for their generation.
    train = _clips(dataset.split("train"), spec) if spec.kind == "learned" else []
    val, truths = _clips(dataset.split("val"), spec), TruthSequence(dataset.split("val"))
    tuned = len(spec.grid) > 1
    if tuned and not len(val):
        raise UsageError(f"{job.fit_data} has no validation scenes, but {job.model!r} is tuned on them; make some.")
    options = {"slots": job.fit_slots} | ({} if job.steps is None else {"steps": job.steps})
    options |= {} if job.profile == "cpu" else {"profile": job.profile}
    changes = spec.on_tracks.get(job.targets[0].key.fit_track)
    options |= {"changes": dict(changes)} if changes else {}
    budget = job.seconds / 2 if tuned else job.seconds
    chosen = choose(spec, options, train, val, truths, seed=job.seed, budget=budget).options
    watch = Watch(val, truths, job.out / WATCHED / f"{job.folder.name}.csv") if job.folder else None
    segmenter = spec.build({**chosen, **({"folder": job.folder, "watch": watch} if job.folder else {})})
    segmenter.fit(train, val, seed=job.seed, budget=budget)
    seconds = float(getattr(segmenter, "fit_seconds", time.perf_counter() - started))
    return _Fitted(spec, segmenter, chosen, seconds, watch)


def _pretrained(spec: ModelSpec, job: Job) -> _Fitted:
    segmenter = spec.build({"slots": job.fit_slots, "checkpoint": job.checkpoint})
    segmenter.fit([], [], seed=job.seed, budget=0.0)
    # The training of these weights may have changed the model's declared settings.
    spec = spec.configured(job.checkpoint) if spec.configured and job.checkpoint else spec
    return _Fitted(spec, segmenter, {}, float("nan"), None)


def _model_rows(job: Job, fitted: _Fitted, target: Target) -> list[RunRow]:
    segmenter, options = _for_target(job, fitted, target)
    scenes = _scenes(target)
    clips = _clips(scenes, fitted.spec)
    seconds_per_frame = _score(job, target, lambda _, clip: segmenter.segment(clip), scenes, clips)
    row = dataclasses.replace(
        blank_row(target.key, fitted.spec, status="ok"),
        config={**(getattr(segmenter, "fitted_settings", None) or fitted.spec.settings_in(job.profile)), **options},
        tuned=fitted.spec.trials_with_labels > 0,
        trials=fitted.spec.trials_with_labels,
        n_scenes=len(scenes),
        parameters=int(getattr(segmenter, "parameters", 0)),
        device=brief(str(getattr(segmenter, "device", "cpu"))),
        measured=Measured(seconds_per_frame, fitted.seconds, peak_mib()),
        pretrained=job.pretrained,
        views=fitted.spec.views.on(scenes.views) if fitted.spec.views else "",
    )
    others = [dataclasses.replace(row, key=key) for key in target.extra.values()]
    return [dataclasses.replace(row, learning_curve=fitted.learning_curve), *others]


def _for_target(job: Job, fitted: _Fitted, target: Target) -> tuple[Segmenter, Options]:
    """Give the fitted model; a model that learns nothing is rebuilt if the track has another number of slots."""
    if fitted.spec.kind == "learned" or target.slots == job.fit_slots:
        return fitted.segmenter, fitted.options
    options = {**fitted.options, "slots": target.slots}
    segmenter = fitted.spec.build(options)
    val = _clips(Dataset(job.fit_data).split("val"), fitted.spec)
    segmenter.fit([], val, seed=job.seed, budget=job.seconds)
    return segmenter, options


def _predictions_row(job: Job, target: Target) -> RunRow:
    assert job.predictions
    scenes = _scenes(target)
    _score(job, target, job.predictions.read, scenes, ClipSequence(scenes))
    return dataclasses.replace(blank_row(target.key, None, status="ok"), n_scenes=len(scenes))


def _scenes(target: Target) -> Split:
    scenes = Dataset(target.data).split(SPLIT)
    if len(scenes) == 0:
        raise UsageError(f"Split {SPLIT!r} of {target.data} has no scenes; generate some.")
    return scenes


def _score(job: Job, target: Target, predict: Predict, scenes: Split, clips: ClipSequence) -> float:
    """Write label maps and scene tables; returns the model's seconds per frame and view."""
    labels = job.out / LABELS / f"{target.key.name}.h5"
    extra = {name: job.out / LABELS / f"{key.name}.h5" for name, key in target.extra.items()}
    seconds = segment_split(predict, clips, labels, target.data, extra)
    for name, path in extra.items():
        score_labels(path, scenes, job.out, target.extra[name].name)
    return seconds / score_labels(labels, scenes, job.out, target.key.name)


def _clips(scenes: Split, spec: ModelSpec) -> ClipSequence:
    return ClipSequence(scenes, uses_labels=spec.uses_labels)
