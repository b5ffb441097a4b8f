"""Text of messages: numbers of things, and names made safe for one line of a terminal or file."""

import unicodedata

MOST_CHARACTERS = 300
"""Longest message; longer ones are shortened."""


def counted(number: int | float, noun: str, plural: str | None = None) -> str:
    """A number of things in words, with the noun in its right form."""
    return f"{number if isinstance(number, int) else f'{number:g}'} {noun if number == 1 else plural or noun + 's'}"


def printable(text: str) -> str:
    r"""Replace line breaks and tabs by spaces, and control characters by question marks.

    >>> printable("one\n  two\x1b[31m")
    'one   two?[31m'
    """
    # Controls and formatting, such as bidirectional overrides and broken UTF-16.
    hidden = ("Cc", "Cf", "Cs")
    return "".join(" " if c.isspace() else "?" if unicodedata.category(c) in hidden else c for c in text)


def one_line(text: str) -> str:
    r"""Make a text `printable`, with single spaces.

    >>> one_line(" one\n  two ")
    'one two'
    """
    return " ".join(printable(text).split())


def brief(text: str, most: int = MOST_CHARACTERS) -> str:
    """Convert a text as `one_line` does, and shorten it to at most `most` characters."""
    line = one_line(text)
    return line if len(line) <= most else f"{line[: most - 4].rstrip()} ..."
