"""Every name that code uses is defined: linters do not look, as jaxtyping's axis names would be undefined to them."""

import builtins
import dis
from collections.abc import Iterator
from pathlib import Path
from types import CodeType

import pytest

from tests.paths import ROOT
from tests.test_imports import sources

ALWAYS = {*dir(builtins), "__file__", "__module__", "__qualname__", "__annotations__", "__path__"}


def test_every_name_is_defined():
    paths = [*sources(), *(str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob("*.py"))]
    assert {path: found for path in paths if (found := undefined(Path(ROOT / path).read_text()))} == {}


@pytest.mark.parametrize(
    "source",
    [
        "sys.exit(0)",
        "def main():\n    return nan",
        "class A:\n    b: int = c",
        "def f():\n    return lambda: [x for y in z]",
    ],
)
def test_an_undefined_name_is_found(source: str):
    assert undefined(source)


def undefined(source: str) -> set[str]:
    """Names that a module loads from its own scope, which neither it nor Python defines anywhere."""
    module = compile(source, "module", "exec", dont_inherit=True)
    parts = [*codes(module)]
    defined = ALWAYS.union(names(module, "STORE_NAME"), *(names(part, "STORE_GLOBAL") for part in parts))
    loaded = [names(part, "LOAD_NAME", "LOAD_GLOBAL") - names(part, "STORE_NAME") for part in parts]
    return set().union(*loaded) - defined


def codes(code: CodeType) -> Iterator[CodeType]:
    """A piece of code and all that is defined in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from codes(constant)


def names(code: CodeType, *operations: str) -> set[str]:
    """Names that some instructions of a piece of code act on."""
    return {str(step.argval) for step in dis.get_instructions(code) if step.opname in operations}
