"""Registry of all models by name.

`find_model(name)` returns the `ModelSpec` of one model. `expand(names)` replaces groups such as `training-free` by
their members. `discover()` lists all models, and the problems of broken plug-ins. A model is built from options: those
of `benchmark.models.interface`, and one value of its grid, the default or the choice of `benchmark.models.tuning`:

    spec = find_model("plane-dbscan")
    segmenter = spec.build({"slots": 9, **spec.default})

Other packages add models through the entry point group `obpose.models`; see `benchmark.models.plugins`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from benchmark.models import plugins
from benchmark.models.adapters import LEARNED
from benchmark.models.classical import CLASSICAL, FLOORS, ORACLES, POSED, STRONGER
from benchmark.models.model_spec import ModelSpec
from benchmark.models.plugins import Problem
from datagen.errors import UsageError, unknown_name

__all__ = ["GROUPS", "MODELS", "Group", "ModelSpec", "Problem", "budget_of", "discover", "expand", "find_model"]

MODELS: dict[str, ModelSpec] = {**FLOORS, **CLASSICAL, **ORACLES, **POSED, **STRONGER, **LEARNED}
"""Models of this package; `discover` adds those of other packages."""


@dataclass(frozen=True)
class Group:
    """Several models under one name."""

    members: tuple[str, ...]
    """Names of its models."""
    budget: float | None = None
    """Equal training budget of all models in a command with this group, in seconds of one core; None: each model's
    own."""


GROUPS: dict[str, Group] = {
    "floors": Group(tuple(FLOORS)),
    "classical": Group(tuple(CLASSICAL)),
    "oracles": Group(tuple(ORACLES)),
    "training-free": Group((*FLOORS, *CLASSICAL, *ORACLES)),
    "poses": Group(tuple(POSED)),
    "stronger": Group(tuple(STRONGER)),
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
"""Groups of models by name; `paper` holds the rows of the paper's tables."""


def discover() -> tuple[dict[str, ModelSpec], list[Problem]]:
    """Find all models by name, plug-ins included, and the problems of plug-ins that cannot be used."""
    foreign, problems = plugins.load(taken=row_names(MODELS) | set(GROUPS))
    return {**MODELS, **foreign}, problems


def row_names(models: Mapping[str, ModelSpec]) -> set[str]:
    """Names of all rows of models in tables: the models themselves, and their further segmentations."""
    return {*models, *(f"{name}-{extra}" for name, spec in models.items() for extra in spec.extra)}


def find_model(name: str) -> ModelSpec:
    """Find a model by name.

    Raises:
        UsageError: it does not exist (suggests a similar name), or is a broken plug-in (names its problem).
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
    """Replace groups by their members, and check that all models exist; each name appears once.

    Raises:
        UsageError: as `find_model`.
    """
    members = [member for name in names for member in (GROUPS[name].members if name in GROUPS else [name])]
    for member in members:
        find_model(member)
    return list(dict.fromkeys(members))


def budget_of(names: Iterable[str]) -> float | None:
    """Equal training budget of the groups among these names, the smallest of several; None if no group has one."""
    budgets = (GROUPS[name].budget for name in names if name in GROUPS)
    return min((budget for budget in budgets if budget is not None), default=None)
