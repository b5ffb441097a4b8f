"""Which models there are: names, how to build them, and what the tables must say about them.

`find_model(name)` gives the `ModelSpec` of one model, `expand(names)` replaces groups such as `training-free` by their
members, `discover()` lists everything with what is wrong with broken plug-ins. A model is built from options, which
are those that `benchmark.interface` offers and one value of its grid, the default or what `benchmark.tuning.choose`
picks:

    spec = find_model("plane-dbscan")
    segmenter = spec.build({"slots": 9, **spec.default})

Other packages add models through the entry point group `obpose.models`; see `benchmark.plugins`.
"""

import difflib
from collections.abc import Iterable

from benchmark import plugins
from benchmark.adapters import LEARNED
from benchmark.baselines import CLASSICAL, FLOORS, ORACLES
from benchmark.model_spec import ModelSpec
from benchmark.plugins import Problem
from datagen.errors import UsageError

__all__ = ["GROUPS", "MODELS", "ModelSpec", "Problem", "discover", "expand", "find_model"]

MODELS: dict[str, ModelSpec] = {**FLOORS, **CLASSICAL, **ORACLES, **LEARNED}
"""The models of this package; those of others come from `discover`."""

GROUPS: dict[str, tuple[str, ...]] = {
    "floors": ("floor",),
    "classical": ("classical",),
    "oracles": ("oracle",),
    "training-free": ("floor", "classical", "oracle"),
}
"""Names that stand for all models in `MODELS` of these kinds."""


def discover() -> tuple[dict[str, ModelSpec], list[Problem]]:
    """All models by name, our own and those of other packages, and what is wrong with those that cannot be used."""
    foreign, problems = plugins.load(taken={*MODELS, *GROUPS})
    return {**MODELS, **foreign}, problems


def find_model(name: str) -> ModelSpec:
    """The model of that name.

    Raises:
        UsageError: there is none, and says which name is near; or it is a plug-in that is broken, and says how.
    """
    if name in MODELS:
        return MODELS[name]
    models, problems = discover()
    if name in models:
        return models[name]
    for problem in problems:
        if problem.name == name:
            raise UsageError(f"Model {name!r} cannot be used: {problem.reason}")
    raise _unknown(name, models)


def expand(names: Iterable[str]) -> list[str]:
    """Names of models, each once, in which groups are replaced by their members; every one of them can be found.

    Raises:
        UsageError: as `find_model`.
    """
    members = [member for name in names for member in _members(name)]
    return list(dict.fromkeys(members))


def _members(name: str) -> list[str]:
    if name not in GROUPS:
        find_model(name)
        return [name]
    return [model for model, spec in MODELS.items() if spec.kind in GROUPS[name]]


def _unknown(name: str, models: Iterable[str]) -> UsageError:
    names = sorted([*models, *GROUPS])
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return UsageError(f"Unknown model {name!r}; {hint}There are: {', '.join(names)}.")
