"""The examples in docstrings hold."""

import doctest
import importlib

import numpy as np
import pytest

from tests.paths import ROOT
from tests.test_imports import module_name, sources

MODULES = [module_name(path) for path in sources() if ">>> " in (ROOT / path).read_text()]


@pytest.mark.parametrize("module", MODULES)
def test_every_example_gives_what_stands_below_it(module: str):
    result = doctest.testmod(importlib.import_module(module), extraglobs={"np": np})
    assert result.attempted
    assert not result.failed
