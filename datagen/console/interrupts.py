"""Handle Ctrl-C cleanly at any time, including during imports and JIT compilation."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from datagen.errors import EXIT_INTERRUPTED

_came = False


def listen() -> None:
    """Remember Ctrl-C besides raising KeyboardInterrupt: numba's compiler callbacks swallow exceptions."""
    signal.signal(signal.SIGINT, _note)
    sys.unraisablehook = _report_others


def check() -> None:
    """Raise an interrupt that was swallowed.

    Raises:
        KeyboardInterrupt: Ctrl-C came since `listen`.
    """
    if _came:
        raise KeyboardInterrupt


@contextmanager
def held() -> Iterator[None]:
    """Block Ctrl-C; processes that are started in this context inherit the block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def interruptible_imports(program: str) -> Iterator[None]:
    """Let Ctrl-C exit at once with one line: libraries may swallow exceptions while they are imported."""

    def leave(_signal: int, _frame: FrameType | None) -> None:
        os.write(sys.stderr.fileno(), f"{program}: Interrupted while it began.\n".encode())
        os._exit(EXIT_INTERRUPTED)

    before = signal.signal(signal.SIGINT, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _note(_signal: int, _frame: FrameType | None) -> None:
    global _came
    _came = True
    raise KeyboardInterrupt


def _report_others(lost: "sys.UnraisableHookArgs") -> None:
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)
