import doctest
import importlib
import math

import pytest

from benchmark.ranking.number_text import decimals_that_show, plain_number


def test_the_examples_in_the_docstrings():
    result = doctest.testmod(importlib.import_module("benchmark.ranking.number_text"))
    assert (result.attempted, result.failed) == (2, 0)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (13740.0, 4, "13740"),
        (13744.6, 4, "13745"),
        (1.374e7, 3, "13740000"),
        (0.0001, 3, "0.0001"),
        (-2.5, 3, "-2.5"),
        (0.0, 4, "0"),
        (-0.0, 4, "0"),
        (100, 3, "100"),
        (2.0, 4, "2"),
        (math.nan, 4, "nan"),
        (math.inf, 4, "inf"),
    ],
)
def test_numbers_have_no_exponent(value: float, digits: int, text: str):
    assert plain_number(value, digits) == text


def test_as_many_decimals_as_it_takes():
    is_shown = lambda rounded, exact: bool(rounded or not exact)  # noqa: E731
    assert decimals_that_show([0.1, 0.0, -0.0004], is_shown) == 4
    assert decimals_that_show([0.1, 0.0], is_shown) == 3
    assert decimals_that_show([1e-9], is_shown) == 6
    assert decimals_that_show([math.nan], is_shown) == 3
    assert decimals_that_show([], is_shown) == 3
