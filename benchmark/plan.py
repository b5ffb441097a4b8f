"""Which rows a request asks for, which of them are there, and the jobs that make the rest."""

import dataclasses
import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmark.adapters.predictions import PredictionFolder
from benchmark.model_spec import ModelSpec
from benchmark.registry import find_model
from benchmark.results import RunKey, RunRow, digest
from benchmark.runner import SPLIT, Job, Target
from benchmark.tracks import Source
from datagen.errors import UsageError

DEFAULT_SECONDS = 600.0
"""That a model may train for."""


@dataclass(frozen=True)
class Request:
    """What is to be compared."""

    models: tuple[str, ...]
    sources: tuple[Source, ...]
    """Tracks or datasets to score on."""
    seeds: int = 3
    fit_source: Source | None = None
    """Where models are fitted, or tuned, once for all; None: on each track itself."""
    seconds: float = DEFAULT_SECONDS
    steps: int | None = None
    """Training steps in the place of seconds."""
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
    """Compare a request with the rows that a run folder has."""
    if request.predictions:
        return _predictions_plan(request, rows, out)
    done = {row.key for row in rows}
    keys, jobs, splits = [], [], {}
    for model, (fit, sources) in itertools.product(request.models, _fits(request)):
        spec = find_model(model)
        for seed in range(request.seeds):
            wanted = {source: _key(request, model, spec, fit, source, seed) for source in sources}
            keys += wanted.values()
            missing = {source: key for source, key in wanted.items() if key not in done}
            if not missing or (seed > 0 and not spec.random):
                continue
            jobs.append(_job(request, model, seed, fit, missing, out))
            _add(splits, fit, ("train", "val") if spec.kind == "learned" else ("val",))
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
            job = _job(request, name, seed, source, {source: key}, out)
            jobs.append(dataclasses.replace(job, predictions=folder))
    return Plan(tuple(keys), tuple(jobs), {source: (SPLIT,)} if jobs else {})


def _add(splits: dict[Source, tuple[str, ...]], source: Source, names: tuple[str, ...]) -> None:
    splits[source] = tuple(sorted({*splits.get(source, ()), *names}))


def _key(request: Request, model: str, spec: ModelSpec, fit: Source, source: Source, seed: int) -> RunKey:
    return RunKey(
        track=source.name,
        model=model,
        fit_track=fit.name,
        seed=seed,
        version=spec.version,
        config_hash=digest(_settings(request, spec)),
        fit_spec=fit.spec_hash,
        track_spec=source.spec_hash,
    )


def repeats(row: RunRow, keys: Iterable[RunKey]) -> list[RunRow]:
    """The rows of other seeds that a row stands for, because seeds make no difference to its model."""
    if row.random:
        return []
    same = (key for key in keys if key != row.key and dataclasses.replace(key, seed=row.key.seed) == row.key)
    return [dataclasses.replace(row, key=key) for key in same]


def check_places(keys: Iterable[RunKey], rows: Iterable[RunRow]) -> None:
    """Check that no wanted row has the place of one made with other settings.

    Raises:
        UsageError: names the first, and says what differs.
    """
    there = {row.key.place: row.key for row in rows}
    for key in keys:
        old = there.get(key.place, key)
        if changed := [name for name, value in dataclasses.asdict(key).items() if getattr(old, name) != value]:
            raise UsageError(
                f"The run folder has a row of {key.model} on {key.track} of other settings ({', '.join(changed)} "
                "differs). Give another folder with --out, the same settings, or --overwrite to replace such rows."
            )


def _fits(request: Request) -> list[tuple[Source, tuple[Source, ...]]]:
    """What is fitted on, and what is scored after each fit."""
    if request.fit_source:
        return [(request.fit_source, request.sources)]
    return [(source, (source,)) for source in request.sources]


def _settings(request: Request, spec: ModelSpec) -> dict[str, object]:
    """Settings that were known before the run and change its results."""
    settings: dict[str, object] = {"grid": [dict(value) for value in spec.grid]}
    if spec.kind == "learned":
        settings["budget"] = [request.seconds, "seconds"] if request.steps is None else [request.steps, "steps"]
    return settings


def _job(request: Request, model: str, seed: int, fit: Source, missing: dict[Source, RunKey], out: Path) -> Job:
    return Job(
        model=model,
        seed=seed,
        fit_data=fit.folder,
        fit_slots=fit.slots,
        targets=tuple(Target(key, source.folder, source.slots) for source, key in missing.items()),
        out=out,
        seconds=request.seconds if request.steps is None else math.inf,
        steps=request.steps,
    )


def _by_track(jobs: Iterable[Job], sources: Sequence[Source]) -> list[Job]:
    """In the order of tracks, so that the first tables are complete early."""
    order = {source.name: number for number, source in enumerate(sources)}
    return sorted(jobs, key=lambda job: order[job.targets[0].key.track])
