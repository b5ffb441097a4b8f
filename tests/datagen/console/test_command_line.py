from dataclasses import dataclass

import pytest

from datagen.console.command_line import Command, given_arguments, run_command
from datagen.errors import (
    EXIT_INCOMPLETE,
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_USAGE,
    EXIT_VERIFICATION,
    CorruptFile,
    UsageError,
)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (["--out", ""], "--out"),
        (["--out="], "--out"),
        (["--out", " "], "--out"),
        (["--out=\t"], "--out"),
        ([""], "Argument 1"),
        (["verify", ""], "Argument 2"),
        (["--recipe", "moving", ""], "Argument 3"),
        (["--recipe=moving", ""], "Argument 2"),
    ],
)
def test_empty_values_are_refused_by_name(arguments: list[str], name: str):
    with pytest.raises(UsageError, match=f"^{name} is empty; expected a value"):
        given_arguments(arguments)


def test_all_other_arguments_are_passed_on(monkeypatch: pytest.MonkeyPatch):
    arguments = ["--set", "model.floor=none", "--by=-0.1,0,0", ".", "--flag", "="]
    assert given_arguments(arguments) == arguments
    monkeypatch.setattr("sys.argv", ["program", *arguments])
    assert given_arguments() == arguments


@dataclass
class Values:
    """Flags."""

    number: int = 1


def raising(error: BaseException) -> int:
    def run(_values: Values) -> int:
        raise error

    return run_command("x", Command(Values, run), arguments=[], interrupted="Kept.", out_of_memory="Give less.")


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (UsageError("Wrong."), EXIT_USAGE, "Wrong."),
        (CorruptFile("Damaged."), EXIT_INCOMPLETE, "Damaged."),
        (KeyboardInterrupt(), EXIT_INTERRUPTED, "Kept."),
        (FileNotFoundError(2, "No such file", "a.h5"), EXIT_INCOMPLETE, "a.h5: No such file."),
        (RuntimeError("not enough memory: 4 bytes"), EXIT_INCOMPLETE, "Give less."),
    ],
)
def test_errors_become_one_line_and_an_exit_code(error: BaseException, code: int, message: str, capsys):
    assert raising(error) == code
    assert capsys.readouterr().err == f"x: {message}\n"


def test_bugs_keep_their_traceback():
    with pytest.raises(ZeroDivisionError):
        raising(ZeroDivisionError())


def run_two(*arguments: str, default: str | None) -> tuple[int, list[tuple[str, int]]]:
    called: list[tuple[str, int]] = []
    commands = {
        "one": Command(Values, lambda values: called.append(("one", values.number))),
        "two": Command(Values, lambda _: EXIT_VERIFICATION, lambda given: {"default": Values(len(given))}),
    }
    return run_command("x", commands, description="About x.", default=default, arguments=arguments), called


def test_a_subcommand_is_found_by_name_or_default(capsys):
    assert run_two("one", "--number", "3", default=None) == (EXIT_OK, [("one", 3)])
    assert run_two("--number", "4", default="one") == (EXIT_OK, [("one", 4)])
    assert run_two("two", default="one") == (EXIT_VERIFICATION, [])
    assert run_two("three", default=None)[0] == EXIT_USAGE
    assert "Unknown subcommand 'three'; expected one of one, two." in capsys.readouterr().err


@pytest.mark.parametrize("default", [None, "one"])
def test_help_describes_the_program(default: str | None, capsys):
    assert run_two("--help", default=default) == (EXIT_OK, [])
    assert "About x." in capsys.readouterr().out


def test_wrong_flags_are_usage_errors(capsys):
    assert run_two("one", "--numbers", "3", default=None)[0] == EXIT_USAGE
    assert run_two("one", "--number=", default=None)[0] == EXIT_USAGE
