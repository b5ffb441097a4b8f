"""Dataclasses from plain values, such as those of JSON and TOML files, with strict types."""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, TypeVar, get_args, get_origin

from cattrs import Converter, transform_error
from cattrs.errors import BaseValidationError, ForbiddenExtraKeysError
from cattrs.gen import make_dict_structure_fn
from cattrs.v import format_exception

from datagen.errors import DatagenError

Built = TypeVar("Built")

_NAMES = {int: "a whole number", float: "a number", str: "a text", bool: "true or false"}
_SHOWN = 40
"""Number of characters that a message shows of a value."""


class UnknownKeys(ValueError):
    """The values have keys that the dataclass lacks."""


@functools.cache
def strict_converter(largest: float = math.inf, *, to_float: bool = False) -> Converter:
    """Make a converter that neither converts values nor ignores keys; whole numbers may stand for other numbers.

    `largest` is the largest absolute value of a number. `to_float` makes floats of these whole numbers.
    """
    converter = Converter()
    for kind in _NAMES:
        converter.register_structure_hook(kind, _plain_hook(kind, largest, to_float=to_float))
    converter.register_structure_hook_factory(lambda kind: get_origin(kind) is Literal, _literal_hook)
    converter.register_structure_hook_factory(lambda kind: get_origin(kind) is tuple, _tuple_hook)
    converter.register_structure_hook_factory(dataclasses.is_dataclass, _dataclass_hook)
    return converter


def structure(values: Any, kind: type[Built], converter: Converter, name: str = "$") -> Built:
    """Build a dataclass from nested dicts and lists with a `strict_converter`; `name` is used in messages.

    Raises:
        UnknownKeys: a key is not a field.
        ValueError: a field is missing or has another type; the message names the first one.
        DatagenError: as raised by the dataclass itself.
    """
    try:
        return converter.structure(values, kind)
    except BaseValidationError as error:
        first: BaseException = error
        while isinstance(first, BaseValidationError):
            first = first.exceptions[0]
        if isinstance(first, DatagenError):
            raise first from None
        kind_of_error = UnknownKeys if isinstance(first, ForbiddenExtraKeysError) else ValueError
        raise kind_of_error(transform_error(error, name, _describe)[0]) from None


def _describe(error: BaseException, kind: Any) -> str:
    return str(error) if type(error) is ValueError else format_exception(error, kind)


def _plain_hook(kind: type, largest: float, *, to_float: bool) -> Callable[[Any, Any], Any]:
    allowed = (int, float) if kind is float else (kind,)

    def check(value: Any, _kind: Any) -> Any:
        if type(value) not in allowed:
            raise ValueError(f"{_brief(value)}, expected {_NAMES[kind]}")
        if isinstance(value, int | float) and not abs(value) <= largest:
            raise ValueError(f"{_brief(value)}, expected a number up to {largest:g}")
        return kind(value) if to_float else value

    return check


def _literal_hook(kind: Any, _converter: Converter) -> Callable[[Any, Any], Any]:
    choices = get_args(kind)

    def check(value: Any, _kind: Any) -> Any:
        if not any(type(value) is type(choice) and value == choice for choice in choices):
            raise ValueError(f"{_brief(value)}, expected one of {', '.join(map(str, choices))}")
        return value

    return check


def _tuple_hook(kind: Any, converter: Converter) -> Callable[[Any, Any], Any]:
    kinds = get_args(kind)

    def build(values: Any, _kind: Any) -> tuple[Any, ...]:
        if not isinstance(values, list | tuple):
            raise ValueError(f"{_brief(values)}, expected a list")
        items = kinds[:1] * len(values) if kinds[-1] is ... else kinds
        if len(values) != len(items):
            raise ValueError(f"{len(values)} values, expected {len(items)}")
        return tuple(converter.structure(value, item) for value, item in zip(values, items, strict=True))

    return build


def _dataclass_hook(kind: type, converter: Converter) -> Callable[[Any, Any], Any]:
    build = make_dict_structure_fn(kind, converter, _cattrs_forbid_extra_keys=True)

    def check(values: Any, _kind: Any) -> Any:
        if not isinstance(values, Mapping):
            raise ValueError(f"{_brief(values)}, expected named values")
        return build(values, kind)

    return check


def _brief(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
