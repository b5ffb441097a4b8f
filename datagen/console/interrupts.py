"""Ctrl-C that ends a command in one line, whenever it comes."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_came = False


def listen() -> None:
    """Take note of Ctrl-C, beside raising KeyboardInterrupt: what is raised while a compiler calls back is lost."""
    signal.signal(signal.SIGINT, _note)
    sys.unraisablehook = _tell_others


def check() -> None:
    """Raise what was swallowed.

    Raises:
        KeyboardInterrupt: Ctrl-C came since `listen`.
    """
    if _came:
        raise KeyboardInterrupt


@contextmanager
def held() -> Iterator[None]:
    """Hold Ctrl-C back; processes that are started meanwhile never hear of it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _note(_signal: int, _frame: FrameType | None) -> None:
    global _came
    _came = True
    raise KeyboardInterrupt


def _tell_others(lost: "sys.UnraisableHookArgs") -> None:
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)
