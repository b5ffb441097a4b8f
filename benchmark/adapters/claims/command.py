"""What the commands of this folder have in common."""

import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

from datagen.errors import DatagenError

Options = TypeVar("Options")


def run_command(
    run: Callable[[Options], int],
    options: type[Options],
    arguments: Sequence[str] | None,
    *,
    program: str,
    about: str | None,
) -> int:
    """Read the options, run, and say in one line what went wrong; the exit code."""
    try:
        return run(tyro.cli(options, prog=program, args=arguments, description=about))
    except DatagenError as error:
        sys.stderr.write(f"{program}: {error}\n")
        return error.exit_code
