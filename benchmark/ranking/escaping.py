"""Text of unknown origin in terminals, Markdown and LaTeX: names and messages must not act as markup or commands.

HTML is escaped by its templates.
"""

import re
import textwrap
import unicodedata

from rich.text import Text

MOST_CHARACTERS = 300
"""Longest message; the rest of a longer one is cut off."""

_MARKDOWN = re.compile(r"([\\`*_\[\]<>|&~])")
_LATEX = str.maketrans(
    {character: f"\\{character}" for character in "&%_#${}"}
    | {"\\": r"\textbackslash{}", "~": r"\~{}", "^": r"\^{}", "[": "{[}", "]": "{]}"}
    | {"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "`": r"\textasciigrave{}", '"': "''"}
    | {"±": r"$\pm$", "†": r"$\dagger$", "‡": r"$\ddagger$", "§": r"\S{}", "–": "--"}
)


def printable(text: str) -> str:
    r"""Give a text with spaces in the place of line breaks and tabs, and question marks in that of control characters.

    >>> printable("one\n  two\x1b[31m")
    'one   two?[31m'
    """
    return "".join(" " if character.isspace() else "?" if _is_control(character) else character for character in text)


def one_line(text: str) -> str:
    r"""Give a text that is `printable`, with single spaces.

    >>> one_line(" one\n  two ")
    'one two'
    """
    return " ".join(printable(text).split())


def brief(text: str) -> str:
    """Give a text as `one_line` does, with at most `MOST_CHARACTERS`."""
    return textwrap.shorten(one_line(text), MOST_CHARACTERS, placeholder=" ...")


def terminal(text: str) -> Text:
    """Give a text for a terminal, in which nothing is markup of Rich or a control sequence."""
    return Text(one_line(text))


def markdown(text: str) -> str:
    r"""Give a text for a Markdown page or a cell of its tables, in which nothing is markup.

    >>> markdown("a|b <script> [x](y)")
    'a\\|b \\<script\\> \\[x\\](y)'
    """
    return _MARKDOWN.sub(r"\\\1", one_line(text))


def latex(text: str) -> str:
    """Give a text for LaTeX, in which nothing is a command or an optional argument."""
    return one_line(text).translate(_LATEX)


def _is_control(character: str) -> bool:
    """Control and formatting characters, such as those that reverse the direction of text, and broken UTF-16."""
    return unicodedata.category(character) in ("Cc", "Cf", "Cs")
