"""What the commands of this folder have in common."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

from datagen.errors import run_program

Options = TypeVar("Options")


def run_command(
    run: Callable[[Options], int],
    options: type[Options],
    arguments: Sequence[str] | None,
    *,
    program: str,
    about: str | None,
) -> int:
    """Read the options and run; the exit code."""
    return run_program(program, lambda: run(tyro.cli(options, prog=program, args=arguments, description=about)))
