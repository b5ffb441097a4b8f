"""Models of other packages: classes under the entry point group `obpose.models`.

Such a class has `fit` and `segment` (`benchmark.models.interface.Segmenter`). Optional attributes describe it further:

- `version`: integer, 1 if left out; raise it when the model's results change, so that they are made again.
- `description`: one line; the first line of the docstring if left out.
- `options`: a tuple of dicts, values of constructor arguments to tune over on the validation split, the first being the
  default. If left out nothing is tuned.
- `random`: False if seeds make no difference.
- `uses_labels`: True if it needs `Clip.truth`; its rows are marked.
- `priors`: its inputs beyond the images, out of `benchmark.models.model_spec.PRIORS`.
- `kind`: one of `benchmark.models.model_spec.KINDS` except "predictions"; "learned" if left out.
- `budget`: training budget in seconds, unless the command sets another; 600.0 if left out.
- `extra`: names of further segmentations that its predictions hold; none if left out.
- `views`: views of a frame that it is given, and views that supervise it, such as ("one", "all").
"""

import inspect
import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, cast

from benchmark.models.interface import Segmenter
from benchmark.models.model_spec import DEFAULT_BUDGET, KINDS, PRIORS, VIEWS_SEEN, Builder, ModelSpec, Views
from benchmark.names import check_model_name, check_row_name, find_twin
from datagen.console.text import brief
from datagen.errors import UsageError

GROUP = "obpose.models"

DEFAULTS: dict[str, Any] = {
    "version": 1,
    "description": "",
    "options": (),
    "random": True,
    "uses_labels": False,
    "priors": (),
    "kind": "learned",
    "budget": DEFAULT_BUDGET,
    "extra": (),
    "views": (),
}
"""Defaults for attributes that a class does not define."""


@dataclass(frozen=True)
class Problem:
    """A plug-in that cannot be used."""

    name: str
    """Name of the model."""
    reason: str
    """Description of the problem: its cause, the package, and the remedy."""


def load(taken: Collection[str] = ()) -> tuple[dict[str, ModelSpec], list[Problem]]:
    """Load the models of other packages by name, and the problems of broken ones; names in `taken` are reserved."""
    entries = sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value))
    times = Counter(entry.name.casefold() for entry in entries)
    models: dict[str, ModelSpec] = {}
    problems: list[Problem] = []
    for entry in entries:
        try:
            _check_name(entry.name, taken, times[entry.name.casefold()])
            spec = spec_of(_load(entry))
            _check_extra(entry.name, spec.extra, {*taken, *(other.name for other in entries)})
            models[entry.name] = spec
        except UsageError as error:
            problems.append(Problem(entry.name, brief(f"{_origin(entry)}: {error}")))
        except Exception as error:  # Attributes of a foreign class may raise anything; it costs this model only.
            reason = f"{_origin(entry)}: it cannot be read: {type(error).__name__}: {error}."
            problems.append(Problem(entry.name, brief(reason)))
    return models, problems


def spec_of(model: Any) -> ModelSpec:
    """Build the specification of a class from its attributes and defaults, and check it.

    Raises:
        UsageError: it is not a model, or an attribute is invalid.
    """
    for method in ("fit", "segment"):
        if not inspect.isclass(model) or not callable(getattr(model, method, None)):
            raise UsageError(f"{model!r} has no method {method!r}; a model is a class with fit and segment.")
    declared = {name: getattr(model, name, default) for name, default in DEFAULTS.items()}
    _check(declared)
    for options in declared["options"] or ({},):
        _check_options(options, inspect.signature(model))
    grid, views = declared.pop("options"), declared.pop("views")
    facts = {
        **declared,
        "description": declared["description"] or inspect.cleandoc(model.__doc__ or model.__name__).splitlines()[0],
        "grid": tuple(grid),
        "priors": tuple(declared["priors"]),
        "views": Views(*views) if views else None,
    }
    return ModelSpec(Builder(cast(type[Segmenter], model)), **facts)


def _check_name(name: str, taken: Collection[str], times: int) -> None:
    check_model_name(name, "Give the entry point another.")
    if "--" in name:
        raise UsageError(f"the name {name!r} has two dashes in a row, which separate the parts of file names.")
    if twin := find_twin(name, taken):
        raise UsageError(f"the name {twin!r} is one of obpose's own; give the entry point another.")
    if times > 1:
        raise UsageError(
            f"{times} entry points have the name {name!r}, upper and lower case being equal; uninstall or rename all "
            "but one."
        )


def _check_extra(name: str, extra: Collection[str], taken: Collection[str]) -> None:
    """Check that the rows of further segmentations, called MODEL-NAME, have unique names."""
    for other in extra:
        check_row_name(f"{name}-{other}", "Give this entry of extra another name.")
        if find_twin(f"{name}-{other}", taken):
            raise UsageError(f"its extra holds {other!r}, but {name}-{other} is a model; give it another name.")


def _load(entry: EntryPoint) -> Any:
    try:
        return entry.load()
    except (Exception, SystemExit) as error:  # Anything may go wrong in a foreign module; it costs this model only.
        raise UsageError(f"it does not import: {type(error).__name__}: {error}.") from error


def _origin(entry: EntryPoint) -> str:
    package = f"package {entry.dist.name}, " if entry.dist else ""
    return f"{package}entry point {entry.value!r}"


def _check(declared: Mapping[str, Any]) -> None:
    for name, default in DEFAULTS.items():
        if type(declared[name]) is not type(default):
            raise UsageError(
                f"its {name} is {declared[name]!r}; expected {type(default).__name__}, such as {default!r}."
            )
    if not 1 <= declared["version"] < 2**31:
        raise UsageError(f"its version is {declared['version']}; the first is 1.")
    if not 0 < declared["budget"] < math.inf:
        raise UsageError(f"its budget is {declared['budget']:g}; expected more than 0 seconds.")
    kinds = [kind for kind in KINDS if kind != "predictions"]
    if declared["kind"] not in kinds:
        raise UsageError(f"its kind is {declared['kind']!r}; expected one of {', '.join(kinds)}.")
    if declared["views"] and (len(declared["views"]) != 2 or not {*declared["views"]} <= {*VIEWS_SEEN}):
        raise UsageError(f"its views are {declared['views']!r}; expected two of {', '.join(VIEWS_SEEN)}.")
    if wrong := [name for name in declared["extra"] if not isinstance(name, str)]:
        raise UsageError(f"its extra holds {wrong[0]!r}; expected names.")
    if unknown := [prior for prior in declared["priors"] if prior not in PRIORS]:
        raise UsageError(f"its priors name {', '.join(map(repr, unknown))}; expected some of {', '.join(PRIORS)}.")


def _check_options(options: Any, signature: inspect.Signature) -> None:
    if not isinstance(options, Mapping):
        raise UsageError(f"its options hold {options!r}; expected a dict of constructor arguments.")
    offered = {"slots": 1} if "slots" in signature.parameters else {}
    try:
        signature.bind(**{**options, **offered})
    except TypeError as error:
        raise UsageError(f"its constructor does not take the options {dict(options)!r} ({error}).") from None
