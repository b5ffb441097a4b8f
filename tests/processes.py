"""Processes that tests start, those that these have started, and whether they are gone."""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

import pytest

from benchmark.execution.executor import Limits, Outcome, Runnable, running_jobs_by
from datagen.errors import Busy, DatagenError


def errors_at_end(process: subprocess.Popen[Any], *, seconds: float = 240) -> Any:
    """Standard error of a process, once it and all that hold its output open have ended.

    If they have not ended in time, they are killed and the test fails. Processes with faulthandler enabled
    (PYTHONFAULTHANDLER=1) write first where they were.
    """
    try:
        return process.communicate(timeout=seconds)[1]
    except subprocess.TimeoutExpired:
        left = {member: command_line(member).replace(b"\0", b" ").decode() for member in _members(process)}
        errors = _end(process, signal.SIGABRT, left) or _end(process, signal.SIGKILL, _members(process))
        named = "\n".join(f"{member}: {line}" for member, line in left.items())
        pytest.fail(f"These have not ended within {seconds:g} s:\n{named}\nThey had written:\n{errors}")


def _end(process: subprocess.Popen[Any], number: int, members: Iterable[int]) -> Any:
    """Send a signal to the members; give all that they had written, or what is known of it, nothing if they go on."""
    for member in members:
        with suppress(ProcessLookupError):
            os.kill(member, number)
    try:
        return process.communicate(timeout=20)[1] or "nothing"
    except subprocess.TimeoutExpired as error:
        return error.stderr if number == signal.SIGKILL else None


def _members(process: subprocess.Popen[Any]) -> set[int]:
    """The process, its descendants in whatever session, and all others that hold its standard error open."""
    running = {process.pid} if process.poll() is None else set()
    holders: set[int] = set()
    if process.stderr and not process.stderr.closed:
        pipe = os.fstat(process.stderr.fileno())
        for entry in Path("/proc").glob("[0-9]*/fd/*"):
            with suppress(OSError):
                if os.path.samestat(entry.stat(), pipe):
                    holders.add(int(entry.parts[2]))
    return (running | holders | set(descendants(process.pid))) - {os.getpid()}


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
    """Command line of a process; empty once it is gone."""
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


def in_this_process() -> AbstractContextManager[None]:
    """Make `run_jobs` run all jobs in this process, without limits; only a `DatagenError` is a failed job."""
    return running_jobs_by(_run_here)


def _run_here(job: Runnable, limits: Limits, stop: threading.Event, on_event: Callable[[str], None]) -> Outcome:
    events: list[str] = []

    def announce(event: str) -> None:
        events.append(event)
        on_event(event)

    try:
        job.run(announce)
    except Busy:
        raise
    except DatagenError as error:
        return Outcome(tuple(events), str(error))
    return Outcome(tuple(events), "")
