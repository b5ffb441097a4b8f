"""Segmentation jobs: fit a model once, then segment, store and score one or more tracks.

A job runs in the calling process; `run_all` runs many of them through `benchmark.execution.executor`.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from benchmark.clips import ClipSequence, TruthSequence
from benchmark.csv_files import Curve
from benchmark.execution.executor import FITTED, Limits, Outcome, run_jobs
from benchmark.machine import commit, peak_mib
from benchmark.models.adapters.predictions import PredictionFolder
from benchmark.models.contract import check_prediction, check_reconstruction
from benchmark.models.interface import Changeable, Clip, Prediction, Reconstructs, Segmenter
from benchmark.models.model_spec import ModelSpec, Options
from benchmark.models.registry import find_model
from benchmark.models.tuning import choose
from benchmark.models.validation import VALIDATION, ValidationScorer
from benchmark.results.labels import write_labels
from benchmark.results.reconstructions import save_reconstruction, shown_images, shown_scenes
from benchmark.results.run_folder import (
    LABELS,
    SCENES,
    Measured,
    RunKey,
    RunRow,
    load_row,
    load_runs,
    row_path,
    save_row,
)
from benchmark.results.scoring import SPLIT, score_labels
from datagen.console.text import brief, one_line
from datagen.errors import UsageError
from datagen.storage.atomic import write_atomically
from datagen.storage.reader import Dataset, Split
from datagen.tracks import REAL_TABLES, Profile

GRACE_SECONDS = 3600.0
"""Time that a job may take in addition to training."""
STARTING_SECONDS = 20.0
"""Time for imports and compilation before the first scene or the first training step."""
OVERHEAD = 1.13
"""Wall time per second of training budget: validation, curve scores, checkpoints and pictures come on top."""
SLOWDOWN = 2.0
"""Largest slowdown by other load: wall time per second of one core. Also the largest time per step, in seconds."""

Predict = Callable[[int, Clip], Prediction]
"""Function that segments a scene, given its number and its clip."""


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
    """A model and a seed: fitted once, scored on every target; implements `benchmark.execution.executor.Runnable`."""

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
    predictions: PredictionFolder | None = None
    """Label maps to score in place of a model."""

    @property
    def learns(self) -> bool:
        """Whether the model is one that learns, in this job or elsewhere."""
        return self.folder is not None or self.checkpoint is not None

    @property
    def pretrained(self) -> str:
        """Name of the trained weights; empty if there are none."""
        return self.checkpoint.name if self.checkpoint else ""

    @property
    def training_seconds(self) -> float:
        """Estimated wall time of training; infinite if the budget is counted in steps, 0 without training."""
        return STARTING_SECONDS + OVERHEAD * self.seconds if self.learns and not self.checkpoint else 0.0

    @property
    def time_limit(self) -> float:
        """Default limit of the seconds until the next row is written."""
        return GRACE_SECONDS + SLOWDOWN * (self.training_seconds if self.steps is None else self.steps)

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the targets' own rows."""
        return tuple(target.key.name for target in self.targets)

    @property
    def state(self) -> tuple[Path, ...]:
        """The model's own files, and the validation scores of its training."""
        return (self.folder, self.out / VALIDATION / f"{self.folder.name}.csv") if self.folder else ()

    def run(self, announce: Callable[[str], None] = lambda event: None) -> None:
        """Make all rows. Calls `announce` with "fitted", then with each target's row name once it is written.

        Raises:
            UsageError: the model, a dataset or a split does not exist, or a split is empty.
            BadPrediction: the model did not return a label for every pixel.
            CorruptFile: a dataset is damaged.
        """
        fitted = None if self.predictions else _fit(find_model(self.model), self)
        announce(FITTED)
        for target in self.targets:
            rows = [_predictions_row(self, target)] if fitted is None else _model_rows(self, fitted, target)
            _save(self, rows)
            announce(target.key.name)


def run_all(
    jobs: Sequence[Job], limits_of: Callable[[Job], Limits], workers: int, on_row: Callable[[RunRow], None]
) -> None:
    """Run jobs within limits, and call `on_row` with every target's row, failed ones included.

    Raises:
        Busy: another process makes one of the rows.
    """

    def on_event(job: Job, event: str) -> None:
        for target in job.targets:
            if target.key.name == event:
                on_row(load_row(row_path(job.out, target.key)))

    def on_failure(job: Job, outcome: Outcome) -> list[Job]:
        left = [target for target in job.targets if target.key.name not in outcome.events]
        # A failed fit concerns all targets, a failed segmentation only the current one.
        failed = left[:1] if FITTED in outcome.events else left
        for target in failed:
            on_row(_save_failure(job, target, outcome.reason))
        rest = tuple(left[len(failed) :])
        return [dataclasses.replace(job, targets=rest)] if rest else []

    run_jobs(jobs, limits_of, workers, on_event=on_event, on_failure=on_failure)


def repeat_rows(keys: Sequence[RunKey], out: Path) -> None:
    """Copy the rows of models without randomness to their other wanted seeds, which were not run."""
    rows = load_runs(out)
    there = {row.key for row in rows}
    for row in rows:
        for key in keys:
            if row.random or key in there or dataclasses.replace(key, seed=row.key.seed) != row.key:
                continue
            table = out / SCENES / f"{row.key.name}.csv"
            if table.exists():
                write_atomically(out / SCENES / f"{key.name}.csv", table.read_bytes())
            save_row(out, dataclasses.replace(row, key=key))


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


def _save_failure(job: Job, target: Target, reason: str) -> RunRow:
    """Write failed rows for all keys of a target, and return its own row."""
    spec = None if job.predictions else find_model(job.model)
    rows = [blank_row(key, spec, status="failed", reason=reason) for key in target.keys]
    rows = [dataclasses.replace(row, pretrained=job.pretrained) for row in rows]
    _save(job, rows)
    return rows[0]


def _save(job: Job, rows: Sequence[RunRow]) -> None:
    """Write a target's rows, its own row last: its existence implies that of the others."""
    for row in rows[::-1]:
        save_row(job.out, row)


@dataclass(frozen=True)
class _Fitted:
    """Result of fitting a model."""

    spec: ModelSpec
    segmenter: Segmenter
    options: Options
    seconds: float
    validation: ValidationScorer | None

    @property
    def learning_curve(self) -> Curve | None:
        """Learning curve that the model recorded, with the validation scores added; None if it is empty."""
        curve = getattr(self.segmenter, "learning_curve", None)
        points = [{one_line(str(name)): float(value) for name, value in point.items()} for point in curve or ()]
        return (self.validation.added_to(points) if self.validation else points) or None


def _fit(spec: ModelSpec, job: Job) -> _Fitted:
    started = time.perf_counter()
    if job.checkpoint:
        return _load(spec, job, job.checkpoint)
    dataset = Dataset(job.fit_data)
    # Only models that learn get training clips, so that other models do not wait for their generation.
    train = _clips(dataset.split("train"), spec) if spec.kind == "learned" else []
    held_out = dataset.split("val")
    labelled = held_out.has("segmentation")
    val, truths = _clips(held_out, spec), TruthSequence(held_out) if labelled else []
    # Tuning needs labels of the validation split.
    tuned = len(spec.grid) > 1
    if tuned and not len(val):
        raise UsageError(
            f"{job.fit_data} has no validation scenes, but {job.model!r} is tuned on them; make some, or tune on a "
            "track with --fit-track."
        )
    if tuned and not labelled:
        raise UsageError(
            f"{job.fit_data} has no masks in split val, but {job.model!r} is tuned on them; add some, or tune on a "
            "track with --fit-track."
        )
    # Options of the constructor; tuning takes half of the budget.
    options = {"slots": job.fit_slots} | ({} if job.steps is None else {"steps": job.steps})
    options |= {} if job.profile == "cpu" else {"profile": job.profile}
    changes = spec.on_tracks.get(job.targets[0].key.fit_track)
    options |= {"changes": dict(changes)} if changes else {}
    budget = job.seconds / 2 if tuned else job.seconds
    chosen = choose(spec, options, train, val, truths, seed=job.seed, budget=budget).options
    scorer = ValidationScorer(val, truths, job.state[1]) if job.folder and labelled else None
    segmenter = spec.build({**chosen, **({"folder": job.folder, "watch": scorer} if job.folder else {})})
    segmenter.fit(train, val, seed=job.seed, budget=budget)
    seconds = float(getattr(segmenter, "fit_seconds", time.perf_counter() - started))
    return _Fitted(spec, segmenter, chosen, seconds, scorer)


def _load(spec: ModelSpec, job: Job, checkpoint: Path) -> _Fitted:
    """Build a model with trained weights."""
    segmenter = spec.build({"slots": job.fit_slots, "checkpoint": checkpoint})
    segmenter.fit([], [], seed=job.seed, budget=0.0)
    # The training of these weights may have changed the model's declared settings.
    spec = spec.configured(checkpoint) if spec.configured else spec
    return _Fitted(spec, segmenter, {}, float("nan"), None)


def _model_rows(job: Job, fitted: _Fitted, target: Target) -> list[RunRow]:
    segmenter, options = _for_target(job, fitted, target)
    scenes = _scenes(target)
    clips = _clips(scenes, fitted.spec)
    segment = segmenter.segment
    if target.key.track in REAL_TABLES:
        from benchmark.models.adapters.own_frames import table_segmenter  # late: PyTorch takes seconds to import

        segment = table_segmenter(segmenter)
    seconds_per_frame = _score(job, target, lambda _, clip: segment(clip), scenes, clips)
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
    # The report shows the first seed.
    if isinstance(segmenter, Reconstructs) and job.seed == 0 and target.key.track not in REAL_TABLES:
        _reconstruct(job.out, row, segmenter, clips)
    others = [dataclasses.replace(row, key=key) for key in target.extra.values()]
    return [dataclasses.replace(row, learning_curve=fitted.learning_curve), *others]


def _for_target(job: Job, fitted: _Fitted, target: Target) -> tuple[Segmenter, Options]:
    """Return the fitted model, with the changes of its settings on the track; given weights keep their settings.

    A model that learns nothing is rebuilt if the track has another number of slots.
    """
    changes = None if job.checkpoint else fitted.spec.at_test.get(target.key.track)
    if changes and isinstance(fitted.segmenter, Changeable):
        return fitted.segmenter.with_changes(changes), fitted.options
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


def segment_split(
    predict: Predict, clips: ClipSequence, path: Path, data: Path, extra: Mapping[str, Path] | None = None
) -> float:
    """Segment every clip of the dataset `data` and store the label maps; returns the seconds that `predict` took.

    `extra` holds files for the segmentations in `Prediction.extra`, by name.

    Raises:
        BadPrediction: `predict` did not return a label for every pixel.
    """
    seconds, extra = 0.0, extra or {}
    with ExitStack() as stack:
        writer = stack.enter_context(write_labels(path, len(clips), data))
        others = {name: stack.enter_context(write_labels(place, len(clips), data)) for name, place in extra.items()}
        for index, clip in enumerate(clips):
            started = time.perf_counter()
            prediction = predict(index, clip)
            seconds += time.perf_counter() - started
            check_prediction(prediction, clip, f"scene {index}", extra)
            writer.put(index, prediction)
            for name, other in others.items():
                other.put(index, Prediction(prediction.extra[name], prediction.background_slot))
    return seconds


def _reconstruct(out: Path, row: RunRow, segmenter: Reconstructs, clips: ClipSequence) -> None:
    """Render the scenes that the report shows."""
    for scene in shown_scenes(len(clips)):
        clip = clips[scene]
        images = shown_images(*clip.depth.shape[:2])
        pictures = segmenter.reconstruct_images(clip, images)
        if pictures is None:
            return
        check_reconstruction(pictures, len(images), clip, f"scene {scene}")
        save_reconstruction(out, row, scene, pictures)


def _clips(scenes: Split, spec: ModelSpec) -> ClipSequence:
    return ClipSequence(scenes, uses_labels=spec.uses_labels)
