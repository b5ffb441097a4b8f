"""Parts of the command line that all commands share: `--version`, and the check for empty values.

Imports nothing slow, so that `--version` answers at once.
"""

import sys
from collections.abc import Sequence

from datagen.errors import UsageError


def answer_version(program: str, arguments: Sequence[str] | None = None) -> bool:
    """Print the version if the arguments ask for it, and say whether they did; None stands for those of the process."""
    if "--version" not in (sys.argv[1:] if arguments is None else arguments):
        return False
    from datagen.version import find_version

    sys.stdout.write(f"{program} {find_version()}\n")
    return True


def given_arguments(arguments: Sequence[str] | None = None) -> list[str]:
    """Give the arguments, or those of the process if None, after a check that none is empty.

    An empty path would mean the current folder, and an empty name the default: both come from an unset variable in a
    script, and neither is meant.

    Raises:
        UsageError: an argument, or the value in `--flag=value`, is empty or only spaces.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    for place, argument in enumerate(given):
        flag, equals, value = argument.partition("=")
        if not argument.strip():
            before = given[place - 1] if place else ""
            name = before if before.startswith("--") and "=" not in before else f"Argument {place + 1}"
        elif flag.startswith("--") and equals and not value.strip():
            name = flag
        else:
            continue
        raise UsageError(f"{name} is empty; expected a value. Give one, or leave it out.")
    return given
