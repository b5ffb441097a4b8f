import pytest

from datagen.console.progress import busy, tracked


@pytest.fixture(params=[True, False])
def terminal(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether standard error counts as a terminal."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR" if request.param else "NO_COLOR", "1")
    return request.param


def test_progress_is_shown_on_terminals_only_and_changes_nothing(terminal: bool, capsys: pytest.CaptureFixture[str]):
    assert list(tracked([3, 1, 2], "reading scores")) == [3, 1, 2]
    assert list(tracked([], "reading scores")) == []
    with busy("writing the report"):
        pass
    shown = capsys.readouterr()
    assert shown.out == ""
    assert ("reading scores" in shown.err) is terminal
    assert ("writing the report" in shown.err) is terminal
    assert bool(shown.err) is terminal
