"""Which trials a search asks for."""

import copy
import math
from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from pathlib import Path

from benchmark.model_spec import ModelSpec, Options
from benchmark.registry import find_model
from benchmark.results import digest
from benchmark.search.trial import Outcome, Trial
from benchmark.tracks import Profile, Source
from datagen.errors import UsageError


def make_trials(
    models: Iterable[str],
    sources: Sequence[Source],
    *,
    seconds: float,
    steps: int | None = None,
    profile: Profile = "cpu",
    out: Path,
) -> list[Trial]:
    """Every declared trial of every model on every track: all trials of a track before the next track.

    Raises:
        UsageError: a model does not exist, or learns nothing.
    """
    models = list(models)
    budget = (math.inf if steps is not None else seconds, steps)
    return [trial for source in sources for model in models for trial in _trials(model, source, budget, profile, out)]


def missing(trials: Iterable[Trial], outcomes: Iterable[Outcome]) -> list[Trial]:
    """Those that have no outcome yet.

    Raises:
        UsageError: the place of one is taken by an outcome of other settings.
    """
    there = {outcome.place: outcome.name for outcome in outcomes}
    left = []
    for trial in trials:
        name = there.get((trial.model, trial.number, trial.track))
        if name is None:
            left.append(trial)
        elif name != trial.name:
            raise UsageError(
                f"{trial.out} has trial {trial.number} of {trial.model} on {trial.track} with another budget, dataset "
                "or settings. Give another folder with --out, or the same settings."
            )
    return left


def _trials(
    model: str, source: Source, budget: tuple[float, int | None], profile: Profile, out: Path
) -> Iterator[Trial]:
    spec = find_model(model)
    if spec.kind != "learned":
        raise UsageError(f"{model!r} learns nothing that could be searched; its values are tuned when it is run.")
    if spec.uses_labels:
        raise UsageError(f"{model!r} learns from labels, and a search is decided without any; leave it out.")
    for number, tried in enumerate(spec.trials):
        changes = {**spec.on_tracks.get(source.name, {}), **tried}
        facts = _facts(spec, source, budget, profile) | {"changes": dict(changes)}
        place = (source.name, source.folder, source.slots)
        yield Trial(model, number, changes, spec.searched_from, *place, *budget, profile, digest(facts), out)


def _facts(spec: ModelSpec, source: Source, budget: tuple[float, int | None], profile: Profile) -> dict[str, object]:
    return {
        "version": spec.version,
        "settings": _with_values(spec.settings_in(profile), spec.searched_from),
        "budget": budget,
        "slots": source.slots,
        "profile": profile,
        "data": source.spec_hash,
    }


def _with_values(settings: Options, values: Options) -> Options:
    """Settings, nested as they are, with some values by dotted name in the place of their own."""
    changed = copy.deepcopy(dict(settings))
    for name, value in values.items():
        *parents, last = name.split(".")
        reduce(dict.__getitem__, parents, changed)[last] = value
    return changed
