"""Processes that others have started, and whether they are gone."""

import time
from collections.abc import Iterator
from pathlib import Path


def descendants(process: int) -> Iterator[int]:
    """Children of a process, their children, and so on."""
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            yield child
            yield from descendants(child)


def command_line(process: int) -> bytes:
    """What a process was started with; empty once it is gone."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


def wait_until_gone(command_lines: dict[int, bytes]) -> None:
    """Fail unless all these processes end within 20 seconds."""
    deadline = time.monotonic() + 20
    while any(line and command_line(process) == line for process, line in command_lines.items()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
