from dataclasses import dataclass
from typing import Any, Literal

import pytest

from datagen.errors import UsageError
from datagen.storage.structure import UnknownKeys, strict_converter, structure


@dataclass(frozen=True)
class Part:
    side: float
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.side < 0:
            raise UsageError("The side is negative.")


@dataclass(frozen=True)
class Whole:
    parts: tuple[Part, Part]
    count: int = 1
    kind: Literal["a", "b"] = "a"
    switch: bool | None = None


VALUES = {"parts": [{"side": 1}, {"side": 2.5, "names": ["x"]}]}


def build(**changes: Any) -> Whole:
    return structure({**VALUES, **changes}, Whole, strict_converter(100.0), "whole")


def test_values_keep_their_types_and_missing_ones_their_defaults():
    found = build(switch=False)
    assert found == Whole((Part(1), Part(2.5, ("x",))), switch=False)
    assert type(found.parts[0].side) is int


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"count": 1.0}, "1.0, expected a whole number @ whole.count"),
        ({"count": True}, "True, expected a whole number @ whole.count"),
        ({"count": "3" * 99}, r"'3{39}\.\.\., expected a whole number"),
        ({"count": 101}, "101, expected a number up to 100"),
        ({"kind": "c"}, "'c', expected one of a, b @ whole.kind"),
        ({"switch": 1}, "1, expected true or false @ whole.switch"),
        ({"parts": []}, "0 values, expected 2 @ whole.parts"),
        ({"parts": "ab"}, "'ab', expected a list @ whole.parts"),
        ({"parts": [{"side": 1}, 3]}, "3, expected named values"),
        ({"parts": [{"side": 1}, {}]}, "required field missing @ whole.parts.side"),
        ({"parts": [{"side": 1}, {"side": float("nan")}]}, "nan, expected a number up to 100"),
    ],
)
def test_the_first_wrong_value_is_named(changes: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=message):
        build(**changes)


def test_unknown_keys_and_our_own_errors_are_told_apart():
    with pytest.raises(UnknownKeys, match=r"\(colour\) @ whole"):
        build(colour=3)
    with pytest.raises(UsageError, match="The side is negative"):
        build(parts=[{"side": 1}, {"side": -1}])


@pytest.mark.parametrize("values", [None, [], "whole", 3])
def test_other_values_are_no_dataclass(values: object):
    with pytest.raises(ValueError, match="expected named values"):
        structure(values, Whole, strict_converter())
