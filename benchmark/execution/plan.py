"""Plan a request: the rows it asks for, the jobs that make the missing ones, and how long they take."""

import dataclasses
import heapq
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.execution.jobs import STARTING_SECONDS, Job, Target
from benchmark.models.adapters.predictions import PredictionFolder
from benchmark.models.interface import object_slots
from benchmark.models.model_spec import ModelSpec
from benchmark.models.registry import find_model
from benchmark.names import PRETRAINED, SLOTS
from benchmark.results.run_folder import TRAINING, RunKey, RunRow, digest
from benchmark.results.scoring import SPLIT
from datagen.console.text import counted
from datagen.errors import UsageError
from datagen.tracks import Profile, RealTable, Source
from obpose.storage.pretrained import content_hash, find_shipped

SCENE_SECONDS = 0.1
"""Time to generate a scene of ten frames on one core; measured in docs/performance.md."""
SCORING_SECONDS = 60.0
"""Time to segment, store and score 300 scenes of ten frames."""


@dataclass(frozen=True)
class Weights:
    """A trained model from a folder."""

    model: str
    """Registry name of the model."""
    folder: Path
    name: str
    """Name in tables, files and keys."""


@dataclass(frozen=True)
class Request:
    """Comparison to be made: models, datasets and options."""

    models: tuple[str, ...]
    sources: tuple[Source, ...]
    """Tracks or datasets to score on."""
    seeds: int = 3
    fit_source: Source | None = None
    """Dataset on which all models are fitted, or tuned, once; None: on each track itself."""
    seconds: float | None = None
    """Training budget of models that learn, in seconds of one core; None: the budget that each declares."""
    steps: int | None = None
    """Training budget in steps, in place of seconds."""
    pretrained: bool = False
    """Whether models that learn use the weights that ship with the package; these run with one seed."""
    weights: tuple[Weights, ...] = ()
    """Trained models to score beside `models`; these run with one seed too."""
    slots: tuple[int, ...] = ()
    """Slot counts to compare, background included; each count other than the track's own makes a separate model."""
    profile: Profile = "cpu"
    """Profile of the models that learn; the sources have their own."""
    predictions: tuple[PredictionFolder, ...] = ()
    """Label maps to score in place of models, one folder per seed; `models` then holds their one name."""


@dataclass(frozen=True)
class Plan:
    """Rows of a request, and the jobs that make the missing ones."""

    keys: tuple[RunKey, ...]
    jobs: tuple[Job, ...]
    """Jobs for the missing rows; a model without randomness gets one job for all seeds."""
    splits: dict[Source, tuple[str, ...]]
    """Splits that the jobs read; the datasets need not exist yet."""


@dataclass(frozen=True)
class Estimate:
    """Estimated duration of a plan, in seconds."""

    data: float
    training: float
    scoring: float

    def __str__(self) -> str:
        parts = (("to make scenes", self.data), ("to train", self.training), ("to score", self.scoring))
        minutes = ", ".join(f"{math.ceil(seconds / 60)} {what}" for what, seconds in parts if seconds)
        total = counted(math.ceil((self.data + self.training + self.scoring) / 60), "minute")
        return f"This takes about {total}, less if a run is resumed: {minutes}."


def estimate(plan: Plan, workers: int) -> Estimate | None:
    """Estimate how long a plan takes from scratch; None if that is unknown.

    It is unknown if budgets are counted in steps, or if no model learns; models that do not learn take seconds.
    """
    learning = [job.training_seconds for job in plan.jobs if job.learns]
    if not learning or math.inf in learning:
        return None
    scenes = sum(source.missing(splits) for source, splits in plan.splits.items())
    data = STARTING_SECONDS + scenes * SCENE_SECONDS / workers if scenes else 0.0
    training = _makespan(learning, workers)
    both = _makespan((job.training_seconds + SCORING_SECONDS * len(job.targets) for job in plan.jobs), workers)
    return Estimate(data, training, both - training)


def _makespan(durations: Iterable[float], workers: int) -> float:
    """Time until the last job ends, if `workers` jobs run at a time and start in this order."""
    ends = [0.0] * workers
    for duration in durations:
        heapq.heapreplace(ends, ends[0] + duration)
    return max(ends)


def make_plan(request: Request, rows: Sequence[RunRow], out: Path) -> Plan:
    """Plan the jobs for a request, given the rows that the run folder already has.

    Raises:
        UsageError: the request asks for weights that do not exist.
    """
    if request.predictions:
        return _predictions_plan(request, rows, out)
    done = {row.key for row in rows}
    keys, jobs, splits = [], [], {}
    # One job for each model, seed and track fitted on, with all tracks that still lack a row.
    for setup, sources in _setups(request):
        for seed in range(setup.seeds):
            targets = {source: setup.target(source, seed) for source in sources}
            keys += [key for target in targets.values() for key in target.keys]
            missing = {source: target for source, target in targets.items() if not done.issuperset(target.keys)}
            # One run serves all seeds of a model that does not depend on them.
            if not missing or (seed > 0 and not setup.spec.random):
                continue
            jobs.append(setup.job(seed, tuple(missing.values()), out))
            _add(splits, setup.fit, setup.splits)
            for source in missing:
                _add(splits, source, (SPLIT,))
    return Plan(tuple(sorted(keys)), tuple(_by_track(jobs, request.sources)), splits)


def _predictions_plan(request: Request, rows: Sequence[RunRow], out: Path) -> Plan:
    done = {row.key for row in rows}
    (name,), (source,) = request.models, request.sources
    keys, jobs = [], []
    for seed, folder in enumerate(request.predictions):
        spec_hash = source.spec_hash
        key = RunKey(source.name, source.name, name, seed, 1, folder.digest(), spec_hash, spec_hash)
        keys.append(key)
        if key not in done:
            target = Target(key, source.folder, source.slots)
            jobs.append(Job(name, seed, source.folder, source.slots, (target,), out, predictions=folder))
    return Plan(tuple(keys), tuple(jobs), {source: (SPLIT,)} if jobs else {})


def _add(splits: dict[Source, tuple[str, ...]], source: Source, names: tuple[str, ...]) -> None:
    splits[source] = tuple(sorted({*splits.get(source, ()), *names}))


def superseded(keys: Iterable[RunKey], rows: Iterable[RunRow]) -> list[RunRow]:
    """Find the rows to be replaced: those with the place of a wanted row but other settings.

    For label maps made elsewhere, all seeds are replaced, so that old and new maps never mix.
    """
    wanted = {key.place: key for key in keys}
    rows = list(rows)
    changed = {row.key.place for row in rows if wanted.get(row.key.place, row.key) != row.key}
    renewed = {row.key.place[:3] for row in rows if row.key.place in changed and row.kind == "predictions"}
    return [
        row
        for row in rows
        if row.key.place in changed or (row.key.place[:3] in renewed and row.key.place not in wanted)
    ]


def check_places(keys: Iterable[RunKey], rows: Iterable[RunRow]) -> None:
    """Check that no wanted row shares its place with a row of other settings.

    Raises:
        UsageError: names the first such row and the settings that differ.
    """
    there = {row.key.place: row for row in rows}
    for key in keys:
        row = there.get(key.place)
        if row is None or row.key == key:
            continue
        if row.kind == "predictions":
            raise UsageError(
                f"The run folder has a row of {key.model} on {key.track} of other label maps or --background-slot, or "
                "of another dataset. Give another --name or --out, or --overwrite to replace all rows of that name."
            )
        changed = [name for name, value in dataclasses.asdict(key).items() if getattr(row.key, name) != value]
        other = (
            "of another version of the dataset" if set(changed) <= {"track_spec", "fit_spec"} else "of other settings"
        )
        raise UsageError(
            f"The run folder has a row of {key.model} on {key.track} {other} (different: {', '.join(changed)}). "
            "Give another folder with --out, the same settings, or --overwrite to replace such rows."
        )


def _fits(request: Request) -> list[tuple[Source, tuple[Source, ...]]]:
    """List each dataset to fit on, with the datasets that are scored after that fit."""
    if request.fit_source:
        return [(request.fit_source, request.sources)]
    return [(source, (source,)) for source in request.sources]


@dataclass(frozen=True)
class _ModelSetup:
    """A requested model, and the source of its weights or tuned values: a fit on a track, or a checkpoint."""

    request: Request
    model: str
    spec: ModelSpec
    fit: Source
    weights: Weights | None
    """Trained weights, used in place of training."""
    slots: int | None = None
    """Number of slots, in place of the track's."""

    @property
    def seeds(self) -> int:
        """Number of seeds; weights are scored once."""
        return 1 if self.weights else self.request.seeds

    @property
    def seconds(self) -> float:
        """Training budget."""
        return self.request.seconds or self.spec.budget

    @property
    def splits(self) -> tuple[str, ...]:
        """Splits that the model is fitted on."""
        if self.weights:
            return ()
        return ("train", "val") if self.spec.kind == "learned" else ("val",)

    def own_slots(self, source: Source) -> int | None:
        """Number of slots if it differs from the model's default on a track; otherwise None."""
        usual = {self.fit.slots} if self.spec.kind == "learned" else {self.fit.slots, source.slots}
        return None if usual == {self.slots} else self.slots

    def name(self, source: Source) -> str:
        """Name of the model in tables, files and keys."""
        if self.weights:
            return self.weights.name
        slots = self.own_slots(source)
        return self.model + (SLOTS.format(object_slots(slots)) if slots else "")

    def settings(self, source: Source) -> dict[str, object]:
        """Settings that are fixed before the run and change its results."""
        if self.weights:
            return {"checkpoint": content_hash(self.weights.folder)}
        settings: dict[str, object] = {"grid": [dict(value) for value in self.spec.grid]}
        if self.spec.kind == "learned":
            steps = self.request.steps
            settings["budget"] = [self.seconds, "seconds"] if steps is None else [steps, "steps"]
        profile = self.request.profile
        # Omit default values, so that rows from before these options existed keep their keys.
        further = {
            "settings": self.spec.settings_in(profile),
            "changes": {**self.spec.on_tracks.get(self.fit.name, {}), **self.spec.at_test.get(source.name, {})},
            "slots": self.own_slots(source),
            "profile": profile if self.spec.kind == "learned" and profile != "cpu" else None,
        }
        return settings | {name: value for name, value in further.items() if value}

    def target(self, source: Source, seed: int) -> Target:
        """Build the target for a seed on a track."""
        name = self.name(source)
        key = RunKey(
            track=source.name,
            model=name,
            fit_track=self.fit.name,
            seed=seed,
            version=self.spec.version,
            config_hash=digest(self.settings(source)),
            fit_spec=self.fit.spec_hash,
            track_spec=source.spec_hash,
        )
        others = () if isinstance(source, RealTable) else self.spec.extra  # obpose-segment gives one segmentation
        extra = {other: dataclasses.replace(key, model=f"{name}-{other}") for other in others}
        return Target(key, source.folder, self.slots or source.slots, extra)

    def job(self, seed: int, targets: tuple[Target, ...], out: Path) -> Job:
        """Build the job of a seed."""
        return Job(
            model=self.model,
            seed=seed,
            fit_data=self.fit.folder,
            fit_slots=self.slots or self.fit.slots,
            targets=targets,
            out=out,
            seconds=self.seconds if self.request.steps is None else math.inf,
            steps=self.request.steps,
            folder=out / TRAINING / self._folder_name(seed) if self.spec.kind == "learned" else None,
            checkpoint=self.weights.folder if self.weights else None,
            profile=self.request.profile,
        )

    def _folder_name(self, seed: int) -> str:
        """Name of the training folder, equal for all tracks that are scored, so that they share one training."""
        facts = [self.spec.version, self.settings(self.fit), self.fit.spec_hash]
        return f"{self.fit.name}--{self.name(self.fit)}--{seed}--{digest({'fit': facts})[:8]}"


def _setups(request: Request) -> Iterator[tuple[_ModelSetup, tuple[Source, ...]]]:
    """Yield all requested setups of all models, each with the datasets that are scored after its fit."""
    for model, (fit, sources) in itertools.product(request.models, _fits(request)):
        numbers = request.slots if find_model(model).takes_slots else ()
        shipped = _shipped(request, model, fit)
        for slots in numbers or (None,):
            yield _ModelSetup(request, model, find_model(model), fit, shipped, slots), sources
    for weights, (fit, sources) in itertools.product(request.weights, _fits(request)):
        yield _ModelSetup(request, weights.model, find_model(weights.model), fit, weights), sources


def trained(request: Request, fit: Source) -> list[Weights]:
    """List all trained weights that a request uses: shipped ones for this track, and given ones.

    Raises:
        UsageError: requested weights do not ship with the package.
    """
    shipped = [_shipped(request, model, fit) for model in request.models]
    return [*filter(None, shipped), *request.weights]


def _shipped(request: Request, model: str, fit: Source) -> Weights | None:
    if not request.pretrained or find_model(model).kind != "learned":
        return None
    return Weights(model, find_shipped(model, fit.name, fit.resolution), model + PRETRAINED)


def _by_track(jobs: Iterable[Job], sources: Sequence[Source]) -> list[Job]:
    """Sort jobs by track, so that the first tables are complete early."""
    order = {source.name: number for number, source in enumerate(sources)}
    return sorted(jobs, key=lambda job: order[job.targets[0].key.track])
