"""What the commands of this folder have in common."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

import tyro

from datagen.console.command_line import run_program
from datagen.errors import UsageError

Options = TypeVar("Options")


@dataclass(frozen=True)
class LabelMaps:
    """Options of a command that looks at label maps."""

    labels: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Label maps of a test split, as a run of obpose-bench leaves them."""
    data: Path | None = None
    """The dataset that the labels are of, if it has moved since."""


def check_csv(path: Path | None) -> None:
    """Refuse a CSV of another name.

    Raises:
        UsageError: it has one.
    """
    if path is not None and path.suffix != ".csv":
        raise UsageError(f"--csv {path}: expected a name that ends with .csv.")


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
