import pytest

from datagen.console.command_line import given_arguments
from datagen.errors import UsageError


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
