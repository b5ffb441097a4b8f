"""docs/paper.md names only what there is: files, functions, methods, and values that are the defaults."""

import ast
import re
from collections.abc import Iterable, Iterator
from functools import cache

import pytest

from obpose.config import Config, override
from obpose.config_text import differences, parse_changes
from obpose.errors import UsageError
from tests.paths import ROOT

CODE = re.compile(r"`([^`\n]+)`")
PLACE = re.compile(r"[a-z0-9_/]+\.py(::[A-Za-z_][\w.]*)?")
DEFAULT = re.compile(r"(model|loss|train)\.[a-z_.]+=.*")

CODES = CODE.findall((ROOT / "docs" / "paper.md").read_text())
PLACES = sorted({code for code in CODES if PLACE.fullmatch(code)} - {"file.py::name", "tests/test_paper_to_code.py"})
DEFAULTS = sorted({code for code in CODES if DEFAULT.fullmatch(code)})


@cache
def names_in(file: str) -> set[str]:
    """Names that a file below obpose/ defines: functions, classes, their methods, constants; nothing is imported.

    Raises:
        FileNotFoundError: there is no such file.
    """
    return set(_names(ast.parse((ROOT / "obpose" / file).read_text()).body))


def _names(body: Iterable[ast.stmt], before: str = "") -> Iterator[str]:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield before + node.name
        if isinstance(node, ast.ClassDef):
            yield from _names(node.body, f"{before}{node.name}.")
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        yield from (before + target.id for target in targets if isinstance(target, ast.Name))


def exists(place: str) -> bool:
    """Whether there is such a `file.py::name` below obpose/."""
    file, _, name = place.partition("::")
    names = names_in(file)
    return not name or name in names


def wrong_defaults(text: str) -> list[str]:
    """Differences from the default configuration.

    Raises:
        UsageError: there is no such value.
    """
    return differences(override(Config(), parse_changes([text])), Config())


def test_the_document_names_many_places_and_values():
    assert len(PLACES) > 60
    assert len(DEFAULTS) > 20


@pytest.mark.parametrize("place", PLACES)
def test_places_exist(place: str):
    assert exists(place)


@pytest.mark.parametrize("text", DEFAULTS)
def test_values_are_the_defaults(text: str):
    assert wrong_defaults(text) == []


def test_every_piece_of_code_that_looks_like_a_place_is_one():
    odd = [code for code in CODES if ("::" in code or ".py" in code) and not PLACE.fullmatch(code)]
    assert odd == []


def test_what_is_not_there_is_noticed():
    assert not exists("geometry.py::to_sphere")
    assert not exists("model/obpose.py::ObPose.dream")
    with pytest.raises(FileNotFoundError):
        exists("model/nerf/clouds.py::render")
    with pytest.raises(UsageError):
        wrong_defaults("loss.beauty=1")
    assert len(wrong_defaults("train.warmup=-1")) == 1
