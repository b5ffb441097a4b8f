import os
import subprocess
import sys

import pytest

from datagen.storage.processes import is_running


def test_this_process_runs_and_one_that_ended_does_not():
    ended = subprocess.Popen([sys.executable, "-c", ""])
    assert is_running(os.getpid())
    ended.wait()
    assert not is_running(ended.pid)


def test_a_process_of_somebody_else_runs(monkeypatch: pytest.MonkeyPatch):
    def refuse(process: int, signal: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "kill", refuse)
    assert is_running(1)


def test_there_are_no_numbers_that_large():
    assert not is_running(10**30)
