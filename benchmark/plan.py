"""Which rows a request asks for, which of them are there, and the jobs that make the rest."""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.adapters.predictions import PredictionFolder
from benchmark.model_spec import ModelSpec
from benchmark.names import PRETRAINED, SLOTS
from benchmark.registry import find_model
from benchmark.results import TRAINING, RunKey, RunRow, digest
from benchmark.runner import SPLIT, Job, Target
from benchmark.tracks import Profile, Source
from datagen.errors import UsageError
from obpose.shipped import content_hash, find_shipped


@dataclass(frozen=True)
class Weights:
    """A trained model from a folder."""

    model: str
    """That it is one of."""
    folder: Path
    name: str
    """In tables, files and keys."""


@dataclass(frozen=True)
class Request:
    """What is to be compared."""

    models: tuple[str, ...]
    sources: tuple[Source, ...]
    """Tracks or datasets to score on."""
    seeds: int = 3
    fit_source: Source | None = None
    """Where models are fitted, or tuned, once for all; None: on each track itself."""
    seconds: float | None = None
    """Of one core, that models that learn may train for; None: what each declares."""
    steps: int | None = None
    """Training steps in the place of seconds."""
    pretrained: bool = False
    """Whether models that learn use the weights that ship with the package; these have one seed."""
    weights: tuple[Weights, ...] = ()
    """Trained models, which stand beside these; they have one seed too."""
    slots: tuple[int, ...] = ()
    """Slots that models may use, the background's included: a model for each number that is not the track's own."""
    profile: Profile = "cpu"
    """Of the models that learn; the sources have their own."""
    predictions: tuple[PredictionFolder, ...] = ()
    """Label maps in the place of models, one folder a seed; `models` then holds the one name that they go by."""


@dataclass(frozen=True)
class Plan:
    """The rows of a request, and what is to be done for them."""

    keys: tuple[RunKey, ...]
    jobs: tuple[Job, ...]
    """Without the rows that are there, and with one seed for all where seeds make no difference."""
    splits: dict[Source, tuple[str, ...]]
    """What the jobs read; their folders need not be there yet."""


def make_plan(request: Request, rows: Sequence[RunRow], out: Path) -> Plan:
    """Compare a request with the rows that a run folder has.

    Raises:
        UsageError: there are no such weights as the request asks for.
    """
    if request.predictions:
        return _predictions_plan(request, rows, out)
    done = {row.key for row in rows}
    keys, jobs, splits = [], [], {}
    for way, sources in _ways(request):
        for seed in range(way.seeds):
            targets = {source: way.target(source, seed) for source in sources}
            keys += [key for target in targets.values() for key in target.keys]
            missing = {source: target for source, target in targets.items() if not done.issuperset(target.keys)}
            if not missing or (seed > 0 and not way.spec.random):
                continue
            jobs.append(way.job(seed, tuple(missing.values()), out))
            _add(splits, way.fit, way.splits)
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


def repeats(row: RunRow, keys: Iterable[RunKey]) -> list[RunRow]:
    """The rows of other seeds that a row stands for, because seeds make no difference to its model."""
    if row.random:
        return []
    same = (key for key in keys if key != row.key and dataclasses.replace(key, seed=row.key.seed) == row.key)
    return [dataclasses.replace(row, key=key) for key in same]


def superseded(keys: Iterable[RunKey], rows: Iterable[RunRow]) -> list[RunRow]:
    """The rows that wanted ones replace: those in their places that were made with other settings.

    Of label maps made elsewhere all seeds go, so that those of other maps do not stand among the new ones.
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
    """Check that no wanted row has the place of one made with other settings.

    Raises:
        UsageError: names the first, and says what differs.
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
        raise UsageError(
            f"The run folder has a row of {key.model} on {key.track} of other settings ({', '.join(changed)} differs). "
            "Give another folder with --out, the same settings, or --overwrite to replace such rows."
        )


def _fits(request: Request) -> list[tuple[Source, tuple[Source, ...]]]:
    """What is fitted on, and what is scored after each fit."""
    if request.fit_source:
        return [(request.fit_source, request.sources)]
    return [(source, (source,)) for source in request.sources]


@dataclass(frozen=True)
class _Way:
    """A model and how it comes by its weights, or values: by fitting on a track, or from a checkpoint."""

    model: str
    spec: ModelSpec
    fit: Source
    seeds: int
    seconds: float
    steps: int | None
    weights: Weights | None
    """In the place of training."""
    slots: int | None
    """In the place of the track's."""
    profile: Profile

    @property
    def splits(self) -> tuple[str, ...]:
        """What it is fitted on."""
        if self.weights:
            return ()
        return ("train", "val") if self.spec.kind == "learned" else ("val",)

    def own_slots(self, source: Source) -> int | None:
        """The number of slots where it is not the one that the model has on a track anyway; else None."""
        usual = {self.fit.slots} if self.spec.kind == "learned" else {self.fit.slots, source.slots}
        return None if usual == {self.slots} else self.slots

    def name(self, source: Source) -> str:
        """In tables, files and keys."""
        if self.weights:
            return self.weights.name
        slots = self.own_slots(source)
        return self.model + (SLOTS.format(slots - 1) if slots else "")

    def settings(self, source: Source) -> dict[str, object]:
        """What was known before the run and changes its results."""
        if self.weights:
            return {"checkpoint": content_hash(self.weights.folder)}
        settings: dict[str, object] = {"grid": [dict(value) for value in self.spec.grid]}
        if self.spec.kind == "learned":
            settings["budget"] = [self.seconds, "seconds"] if self.steps is None else [self.steps, "steps"]
        # What is as ever is not named, so that rows that were made before there was a choice keep their keys.
        further = {
            "settings": self.spec.settings_in(self.profile),
            "changes": dict(self.spec.on_tracks.get(self.fit.name, {})),
            "slots": self.own_slots(source),
            "profile": self.profile if self.spec.kind == "learned" and self.profile != "cpu" else None,
        }
        return settings | {name: value for name, value in further.items() if value}

    def target(self, source: Source, seed: int) -> Target:
        """The rows of a seed on a track."""
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
        extra = {other: dataclasses.replace(key, model=f"{name}-{other}") for other in self.spec.extra}
        return Target(key, source.folder, self.slots or source.slots, extra)

    def job(self, seed: int, targets: tuple[Target, ...], out: Path) -> Job:
        """The work of a seed."""
        return Job(
            model=self.model,
            seed=seed,
            fit_data=self.fit.folder,
            fit_slots=self.slots or self.fit.slots,
            targets=targets,
            out=out,
            seconds=self.seconds if self.steps is None else math.inf,
            steps=self.steps,
            folder=out / TRAINING / self._folder_name(seed) if self.spec.kind == "learned" else None,
            checkpoint=self.weights.folder if self.weights else None,
            profile=self.profile,
        )

    def _folder_name(self, seed: int) -> str:
        """The same for all tracks that are scored, so that none of them needs training anew."""
        facts = [self.spec.version, self.settings(self.fit), self.fit.spec_hash]
        return f"{self.fit.name}--{self.name(self.fit)}--{seed}--{digest({'fit': facts})[:8]}"


def _ways(request: Request) -> Iterator[tuple[_Way, tuple[Source, ...]]]:
    """Every model in every way that is asked for, and what is scored after it."""
    for model, (fit, sources) in itertools.product(request.models, _fits(request)):
        numbers = request.slots if find_model(model).takes_slots else ()
        shipped = _shipped(request, model, fit)
        for slots in numbers or (None,):
            yield _way(request, model, fit, shipped, slots), sources
    for weights, (fit, sources) in itertools.product(request.weights, _fits(request)):
        yield _way(request, weights.model, fit, weights), sources


def _way(request: Request, model: str, fit: Source, weights: Weights | None, slots: int | None = None) -> _Way:
    spec = find_model(model)
    return _Way(
        model,
        spec,
        fit,
        seeds=1 if weights else request.seeds,
        seconds=request.seconds or spec.budget,
        steps=request.steps,
        weights=weights,
        slots=slots,
        profile=request.profile,
    )


def trained(request: Request, fit: Source) -> list[Weights]:
    """All weights of a request, of models that are or were trained on a track.

    Raises:
        UsageError: some that are asked for do not ship with the package.
    """
    shipped = [_shipped(request, model, fit) for model in request.models]
    return [*filter(None, shipped), *request.weights]


def _shipped(request: Request, model: str, fit: Source) -> Weights | None:
    if not request.pretrained or find_model(model).kind != "learned":
        return None
    return Weights(model, find_shipped(model, fit.name, fit.resolution), model + PRETRAINED)


def _by_track(jobs: Iterable[Job], sources: Sequence[Source]) -> list[Job]:
    """In the order of tracks, so that the first tables are complete early."""
    order = {source.name: number for number, source in enumerate(sources)}
    return sorted(jobs, key=lambda job: order[job.targets[0].key.track])
