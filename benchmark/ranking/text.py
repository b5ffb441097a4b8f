"""Text of tables: readable numbers, and names and messages escaped so that they cannot act as markup or commands.

HTML is escaped by its templates.
"""

import math
import re
from collections.abc import Callable, Iterable

from rich.text import Text

from datagen.console.text import one_line

FEWEST_DECIMALS, MOST_DECIMALS = 3, 6

_MARKDOWN = re.compile(r"([\\`*_\[\]<>|&~])")
_LATEX = str.maketrans(
    {character: f"\\{character}" for character in "&%_#${}"}
    | {"\\": r"\textbackslash{}", "~": r"\~{}", "^": r"\^{}", "[": "{[}", "]": "{]}"}
    | {"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "`": r"\textasciigrave{}", '"': "''"}
    | {"±": r"$\pm$", "°": r"$^\circ$", "†": r"$\dagger$", "‡": r"$\ddagger$", "§": r"\S{}", "–": "--"}
)


def terminal(text: str) -> Text:
    """Convert a text for a terminal; markup of Rich and control sequences have no effect."""
    return Text(one_line(text))


def markdown(text: str) -> str:
    r"""Escape a text for a Markdown page or a cell of its tables.

    >>> markdown("a|b <script> [x](y)")
    'a\\|b \\<script\\> \\[x\\](y)'
    """
    return _MARKDOWN.sub(r"\\\1", one_line(text))


def latex(text: str) -> str:
    """Escape a text for LaTeX."""
    return one_line(text).translate(_LATEX)


def plain_number(value: int | float, digits: int = 4) -> str:
    """Round to significant digits, and write the number without an exponent; whole digits are never rounded away.

    >>> [plain_number(value) for value in (13740.0, 0.00012346, 1e6, 2.5)]
    ['13740', '0.0001235', '1000000', '2.5']
    """
    if not math.isfinite(value) or not value:
        return f"{value:z.0f}"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:z.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def decimals_that_show(values: Iterable[float], is_shown: Callable[[float, float], bool]) -> int:
    """Find the fewest decimals, from 3 to 6, with which rounding keeps a property of every value.

    `is_shown` tells whether a rounded value, the first argument, still has the property of the exact one.

    >>> decimals_that_show([0.00031], lambda rounded, exact: bool(rounded) == bool(exact))
    4
    """
    known = [value for value in values if math.isfinite(value)]
    for decimals in range(FEWEST_DECIMALS, MOST_DECIMALS):
        if all(is_shown(round(value, decimals), value) for value in known):
            return decimals
    return MOST_DECIMALS
