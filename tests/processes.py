"""Processes that tests start, those that these have started, and whether they are gone."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest


def errors_at_end(process: subprocess.Popen[Any], *, seconds: float = 240) -> Any:
    """What a process has written to its standard error, once it and all that hold its output open have ended.

    The process must lead a session of its own. If they have not ended in time, they are killed and the test fails.
    """
    try:
        return process.communicate(timeout=seconds)[1]
    except subprocess.TimeoutExpired:
        left = "\n".join(f"{member}: {line.decode()}" for member, line in session_members(process.pid).items())
        os.killpg(process.pid, signal.SIGKILL)
        _, errors = process.communicate(timeout=20)
        pytest.fail(f"These have not ended within {seconds:g} s:\n{left}\nThey had written:\n{errors}")


def session_members(leader: int) -> dict[int, bytes]:
    """Command lines of the processes of a session, empty for one that has ended but was not waited for."""
    found = {}
    for process in (int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()):
        with suppress(OSError):
            if os.getsid(process) == leader:
                found[process] = command_line(process).replace(b"\0", b" ")
    return found


def descendants(process: int) -> Iterator[int]:
    """Children of a process, their children, and so on."""
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            children = task.read_text().split()
        except OSError:  # it has ended meanwhile
            continue
        for child in map(int, children):
            yield child
            yield from descendants(child)


def command_line(process: int) -> bytes:
    """What a process was started with; empty once it is gone."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


def wait_until_gone(command_lines: dict[int, bytes]) -> None:
    """Fail unless all these processes end within a minute."""
    wait_until(
        lambda: not any(line and command_line(process) == line for process, line in command_lines.items()),
        what=f"the end of {command_lines}",
    )


def wait_until(happened: Callable[[], object], *, seconds: float = 60, what: str) -> None:
    """Look until something has happened; fail if it takes longer."""
    deadline = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < deadline, f"waited {seconds:g} s for {what}"
        time.sleep(0.005)
