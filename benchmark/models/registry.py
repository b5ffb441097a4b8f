"""Which models there are: names, how to build them, and what the tables must say about them.

`find_model(name)` gives the `ModelSpec` of one model, `expand(names)` replaces groups such as `training-free` by their
members, `discover()` lists everything with what is wrong with broken plug-ins. A model is built from options: those
of `benchmark.models.interface`, and one value of its grid, the default or the choice of `benchmark.models.tuning`:

    spec = find_model("plane-dbscan")
    segmenter = spec.build({"slots": 9, **spec.default})

Other packages add models through the entry point group `obpose.models`; see `benchmark.models.plugins`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from benchmark.models import plugins
from benchmark.models.adapters import LEARNED
from benchmark.models.classical import CLASSICAL, FLOORS, ORACLES, POSED
from benchmark.models.model_spec import ModelSpec
from benchmark.models.plugins import Problem
from datagen.errors import UsageError, unknown_name

__all__ = ["GROUPS", "MODELS", "Group", "ModelSpec", "Problem", "budget_of", "discover", "expand", "find_model"]

MODELS: dict[str, ModelSpec] = {**FLOORS, **CLASSICAL, **ORACLES, **POSED, **LEARNED}
"""The models of this package; those of others come from `discover`."""


@dataclass(frozen=True)
class Group:
    """A name that stands for several models."""

    members: tuple[str, ...]
    """Names of its models."""
    budget: float | None = None
    """Seconds of one core that all models of a command with this group may train for, so that none has more than
    another; None: what each declares."""


GROUPS: dict[str, Group] = {
    "floors": Group(tuple(FLOORS)),
    "classical": Group(tuple(CLASSICAL)),
    "oracles": Group(tuple(ORACLES)),
    "training-free": Group((*FLOORS, *CLASSICAL, *ORACLES)),
    "poses": Group(tuple(POSED)),
    "paper": Group(
        (
            "obpose-loc",
            "obpose",
            "ic-sbp",
            "slot-attention",
            "obsurf",
            "obsurf-no-overlap",
            "obsurf-no-overlap-depth",
        ),
        budget=12 * 60.0,
    ),
}
"""Names that stand for several models; `paper` are the rows of the paper's tables."""


def discover() -> tuple[dict[str, ModelSpec], list[Problem]]:
    """All models by name, our own and those of other packages, and what is wrong with those that cannot be used."""
    foreign, problems = plugins.load(taken=row_names(MODELS) | set(GROUPS))
    return {**MODELS, **foreign}, problems


def row_names(models: Mapping[str, ModelSpec]) -> set[str]:
    """Names of the rows that models have in tables: their own, and those of further segmentations."""
    return {*models, *(f"{name}-{extra}" for name, spec in models.items() for extra in spec.extra)}


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
        if problem.name.casefold() == name.casefold():
            raise UsageError(f"Model {name!r} cannot be used: {problem.reason}")
    raise unknown_name("model", name, sorted([*models, *GROUPS]))


def expand(names: Iterable[str]) -> list[str]:
    """Names of models, each once, in which groups are replaced by their members; every one of them can be found.

    Raises:
        UsageError: as `find_model`.
    """
    members = [member for name in names for member in (GROUPS[name].members if name in GROUPS else [name])]
    for member in members:
        find_model(member)
    return list(dict.fromkeys(members))


def budget_of(names: Iterable[str]) -> float | None:
    """The equal budget that goes with groups among these names, the smallest of several; None where none has one."""
    budgets = (GROUPS[name].budget for name in names if name in GROUPS)
    return min((budget for budget in budgets if budget is not None), default=None)
