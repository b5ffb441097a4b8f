"""Draw one of several things."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from numpy.random import Generator

Mutator = Callable[[Path, Generator], str]
"""Edits one file in place and returns what it did, which depends on the file and the generator alone."""


def pick(rng: Generator, choices: Sequence[Any]) -> Any:
    """One of the choices, as it is."""
    return choices[int(rng.integers(len(choices)))]
