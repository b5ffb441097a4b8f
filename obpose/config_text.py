"""Configurations as text: JSON beside a checkpoint, `name=value` on the command line, and lists of differences."""

import dataclasses
import difflib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, get_args, get_origin, get_type_hints

from datagen.console.text import brief, counted
from obpose.config import Config, override
from obpose.errors import UsageError

Plain = dict[str, Any]
"""A configuration as nested dicts of JSON values."""
_NAMED, _LONGEST = 3, 80
"""Largest number of unknown values that a message names, and of characters that it shows of a name."""
_LARGEST = 2**63 - 1
"""Largest absolute value of a whole number."""
ADDED_LATER: Plain = {"image_scale": 1, "rise": 0.0, "clean_depth": False, "self_training": False}
"""Values that older files lack, with what older versions did. Settings of results leave them out where they have these
values, so that older results keep their keys."""


def to_plain(config: Any) -> Plain:
    """Convert a configuration to nested dicts of JSON values."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def from_plain(plain: Mapping[str, Any], kind: type = Config) -> Any:
    """Rebuild a configuration of this kind: the inverse of `to_plain`.

    Raises:
        UsageError: a value is missing and not among `ADDED_LATER`, a name is unknown, or a value is of the wrong kind.
    """
    kinds, values = dict(_kinds(kind, "")), dict(_flatten(plain, ""))
    if unknown := sorted(values.keys() - kinds.keys()):
        names = ", ".join(brief(name, _LONGEST) for name in unknown[:_NAMED]) + ", ..." * (len(unknown) > _NAMED)
        raise UsageError(f"The configuration has unknown values, {names}: it was written by another version.")
    changes = {name: _conform(value, kinds[name], name) for name, value in values.items()}
    missing = [name for name in kinds if name not in values]
    later = {name: ADDED_LATER[last] for name in missing if (last := name.rpartition(".")[2]) in ADDED_LATER}
    if missing := [name for name in missing if name not in later]:
        others = f" and {counted(len(missing) - 1, 'other value')}" if missing[1:] else ""
        raise UsageError(f"The configuration lacks {missing[0]}{others}: the file is damaged, or was written by hand.")
    return override(kind(), later | changes)


def _flatten(plain: Mapping[str, Any], place: str) -> Iterator[tuple[str, Any]]:
    """Iterate over the dotted names and values of nested dicts."""
    for name, value in plain.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{place}{name}.")
        else:
            yield place + name, value


def parse_changes(texts: Iterable[str], kind: type = Config) -> dict[str, Any]:
    """Parse texts such as `model.pose.box_size=0.3` into changes of a configuration. Tuples: 16,32 or [16,32].

    Raises:
        UsageError: an unknown name, or a value of the wrong kind.
    """
    changes: dict[str, Any] = {}
    kinds = dict(_kinds(kind, ""))
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise UsageError(f"--set {text}: expected NAME=VALUE, such as model.pose.box_size=0.3.")
        if name not in kinds:
            near = difflib.get_close_matches(name, kinds, n=1, cutoff=0.5)
            hint = f"did you mean {near[0]!r}? They" if near else "they"
            modules = dict.fromkeys(base.__module__ for base in kind.__mro__ if dataclasses.is_dataclass(base))
            places = " and ".join(module.replace(".", "/") + ".py" for module in modules)
            raise UsageError(f"--set {text}: unknown value {name!r}; {hint} are listed in {places}.")
        changes[name] = _conform(_read(value, kinds[name]), kinds[name], f"--set {name}")
    return changes


def differences(one: Any, other: Any) -> list[str]:
    """List the values that differ, such as `train.batch: 2, 4`; or the kinds of configuration, if these differ."""
    if type(one) is not type(other):
        return [f"the kind of model: {type(one).__name__}, {type(other).__name__}"]
    first, second = dict(dotted_values(one)), dict(dotted_values(other))
    return [f"{name}: {value}, {second[name]}" for name, value in first.items() if value != second[name]]


def dotted_values(config: Any, place: str = "") -> Iterator[tuple[str, Any]]:
    """Iterate over all values that are not configurations themselves, with their dotted names."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from dotted_values(value, f"{place}{field.name}.")
        else:
            yield place + field.name, value


def _conform(value: Any, kind: Any, name: str) -> Any:
    """Convert a value to the type `kind`.

    Raises:
        UsageError: the value is not of this type.
    """
    from datagen.storage.structure import strict_converter  # late: --help needs no cattrs

    # A training that counts steps may have infinite minutes.
    largest = math.inf if isinstance(value, float) else _LARGEST
    try:
        return strict_converter(largest, to_float=True).structure(value, kind)
    except ValueError as error:
        found, _, expected = str(error).rpartition(", expected ")
        said = f": {found}, " if isinstance(value, list | tuple) else f"={brief(str(value), _LONGEST)}: "
        or_none = " or none" if type(None) in get_args(kind) else ""
        raise UsageError(f"{name}{said}expected {expected}{or_none}.") from None


def _read(text: str, kind: Any) -> Any:
    """Parse a text: JSON, a list without brackets, `none`, `True` or `False`, or else the text itself."""
    from datagen.storage.safe_io import parse_json  # late: --help needs no NumPy

    if get_origin(kind) is tuple and not text.startswith("["):
        text = f"[{text}]"
    if text.lower() in ("none", "null") and type(None) in get_args(kind):
        return None
    if kind is bool:
        text = text.lower()
    try:
        return parse_json(text)
    except ValueError:  # bad JSON, but also NaN, infinity and numbers of thousands of digits
        return text


def _kinds(kind: type, place: str) -> Iterator[tuple[str, Any]]:
    """Iterate over the dotted names of all values that are not configurations themselves, with their annotations."""
    for name, inner in get_type_hints(kind).items():
        if dataclasses.is_dataclass(inner) and isinstance(inner, type):
            yield from _kinds(inner, f"{place}{name}.")
        else:
            yield place + name, inner
