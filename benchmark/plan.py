"""Which rows a request asks for, which of them are there, and the jobs that make the rest."""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

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
    done = {row.key for row in rows}
    keys, jobs, splits = [], [], {}
    for model in request.models:
        spec = find_model(model)
        for fit, sources in _fits(request):
            for seed in range(request.seeds):
                wanted = {source: run_key(request, model, spec, fit, source, seed) for source in sources}
                keys += wanted.values()
                missing = {source: _first(key, spec) for source, key in wanted.items()}
                missing = {source: key for source, key in missing.items() if key not in done}
                if not missing or (seed > 0 and not spec.random):
                    continue
                jobs.append(_job(request, model, fit, seed, missing, out))
                fitted_on = ("train", "val") if spec.kind == "learned" else ("val",)
                splits[fit] = tuple(sorted({*splits.get(fit, ()), *fitted_on}))
                splits |= {source: tuple(sorted({*splits.get(source, ()), SPLIT})) for source in missing}
    return Plan(tuple(sorted(keys)), tuple(_by_track(jobs, request.sources)), splits)


def run_key(request: Request, model: str, spec: ModelSpec, fit: Source, source: Source, seed: int) -> RunKey:
    """The key of one row of a request."""
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


def _first(key: RunKey, spec: ModelSpec) -> RunKey:
    return key if spec.random else dataclasses.replace(key, seed=0)


def _job(request: Request, model: str, fit: Source, seed: int, missing: dict[Source, RunKey], out: Path) -> Job:
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
