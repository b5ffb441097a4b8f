import math
import re

import pytest

from benchmark.ranking.text import decimals_that_show, latex, markdown, plain_number, terminal
from datagen.console.text import MOST_CHARACTERS, brief, one_line, printable
from tests.chosen_scores import HOSTILE


@pytest.mark.parametrize("escaped", [printable, one_line, brief, markdown, latex, lambda text: terminal(text).plain])
def test_a_text_becomes_one_line_that_can_be_stored(escaped):
    text = escaped(HOSTILE)
    assert text.encode()
    assert text.isprintable()
    assert "\n" not in text


def test_long_messages_are_cut_off():
    assert len(brief("word " * 1000)) <= MOST_CHARACTERS
    assert brief("x" * 1000, 80) == f"{'x' * 76} ..."
    assert brief("x" * 80, 80) == "x" * 80
    assert brief("  short\n") == "short"


def test_markdown_shows_a_text_as_it_is():
    escaped = markdown(HOSTILE)
    assert re.sub(r"\\([\\`*_\[\]<>|&~])", r"\1", escaped) == one_line(HOSTILE)
    assert not re.search(r"(?<!\\)[`*_\[\]<>|&~]", escaped.replace("\\\\", ""))


def test_latex_has_no_optional_arguments_after_the_end_of_a_row():
    """A row that begins with [ would be read as the height of the row before."""
    assert latex("[3cm] x") == "{[}3cm{]} x"


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
