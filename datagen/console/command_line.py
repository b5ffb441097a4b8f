"""The command line of all programs: entry point, subcommands, checks of arguments, and exit codes.

Imports nothing slow, so that `--version` answers at once.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from datagen.console import interrupts
from datagen.errors import EXIT_INCOMPLETE, EXIT_INTERRUPTED, EXIT_OK, DatagenError, UsageError, is_out_of_memory


@dataclass(frozen=True)
class Command:
    """One command or subcommand."""

    arguments: type
    """Dataclass from which the flags are derived."""
    run: Callable[[Any], int | None] | str
    """Function of the parsed arguments; returns the exit code, or None for success. As text, "module:function", it is
    imported after the arguments are parsed, so that --help and wrong flags need no slow libraries."""
    options: Callable[[list[str]], dict[str, Any]] = lambda _arguments: {}
    """Further options of `tyro.cli`, as a function of the unparsed arguments."""


def start(program: str, module: str, **options: Any) -> int:
    """Entry point of a console script: answer `--version`, or import the module and return what its `main` returns.

    Ctrl-C ends it in one line, also during the imports, which can take seconds.
    """
    try:
        if "--version" in sys.argv[1:]:
            from datagen.version import find_version

            sys.stdout.write(f"{program} {find_version()}\n")
            return EXIT_OK
        with interrupts.interruptible_imports(program):
            main = import_module(module).main
        interrupts.listen()
        return main(**options)
    except KeyboardInterrupt:
        return _fail(program, "Interrupted.", EXIT_INTERRUPTED)


def run_command(
    program: str,
    commands: Command | Mapping[str, Command],
    *,
    description: str | None = None,
    default: str | None = None,
    arguments: Sequence[str] | None = None,
    interrupted: str = "Interrupted.",
    out_of_memory: str | None = None,
) -> int:
    """Parse the arguments, run the command, and return its exit code.

    Args:
        program: Name that the user called.
        commands: One command, or subcommands by name.
        description: Text of `--help`, usually the module's docstring.
        default: Subcommand that runs if none is named; None requires a name.
        arguments: The command's arguments; None takes those of the process.
        interrupted: Message after Ctrl-C.
        out_of_memory: Message if memory runs out; None passes that error on.
    """
    if isinstance(commands, Command):
        commands, default = {"": commands}, ""

    def run() -> int:
        return _dispatch(program, commands, description, default, given_arguments(arguments))

    return run_program(program, run, interrupted=interrupted, out_of_memory=out_of_memory)


def _dispatch(
    program: str, commands: Mapping[str, Command], description: str | None, default: str | None, given: list[str]
) -> int:
    import tyro  # late: `--version` does not need it

    if given and given[0] in commands:
        name = given.pop(0)
    elif default is not None:
        name = default
    elif not given or given[0] in ("-h", "--help"):
        sys.stdout.write(f"{description}\nSubcommands, each with a --help of its own: {', '.join(commands)}.\n")
        return EXIT_OK
    else:
        raise UsageError(f"Unknown subcommand {given[0]!r}; expected one of {', '.join(commands)}.")
    command, called = commands[name], program if name == default else f"{program} {name}"
    # tyro's help keeps empty lines only.
    text = "\n\n".join(filter(None, description.split("\n"))) if description and name == default else None
    options = {"description": text, **command.options(given)}
    values = tyro.cli(command.arguments, prog=called, args=given, **options)
    return _function(program, command.run)(values) or EXIT_OK


def _function(program: str, run: Callable[[Any], int | None] | str) -> Callable[[Any], int | None]:
    """Import the function of a command if it is given as text."""
    if not isinstance(run, str):
        return run
    module, name = run.split(":")
    with interrupts.interruptible_imports(program):
        return getattr(import_module(module), name)


def run_program(
    program: str, run: Callable[[], int], *, interrupted: str = "Interrupted.", out_of_memory: str | None = None
) -> int:
    """Run a function and return its exit code; failures that a user can fix end in one line on stderr.

    `interrupted` and `out_of_memory` are messages as in `run_command`; a KeyboardInterrupt may carry its own.
    """
    try:
        return run()
    except SystemExit as error:  # the end of the parser, after --help or wrong flags
        return error.code if isinstance(error.code, int) else int(bool(error.code))
    except DatagenError as error:
        return _fail(program, str(error), error.exit_code)
    except KeyboardInterrupt as error:
        return _fail(program, str(error) or interrupted, EXIT_INTERRUPTED)
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        return _fail(program, f"{place}{error.strerror or error}.", EXIT_INCOMPLETE)
    except (MemoryError, RuntimeError) as error:
        if out_of_memory is None or not is_out_of_memory(error):
            raise
        return _fail(program, out_of_memory, EXIT_INCOMPLETE)


def _fail(program: str, message: str, code: int) -> int:
    sys.stderr.write(f"{program}: {message}\n")
    return code


def given_arguments(arguments: Sequence[str] | None = None) -> list[str]:
    """Return the arguments, or those of the process if None, after a check that none is empty.

    An empty path would mean the current folder, and an empty name the default. Both come from unset variables in
    scripts, and neither is intended.

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
