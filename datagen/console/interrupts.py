"""Handle Ctrl-C cleanly at any time, including during imports and JIT compilation."""

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from datagen.errors import EXIT_INCOMPLETE, EXIT_INTERRUPTED

_PARENT_CHECK_SECONDS = 0.2

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


def end_with(parent: int, clean_up: Callable[[], object] = lambda: None) -> None:
    """Exit as soon as another process is the parent of this one, as after the parent was killed."""

    def watch() -> None:
        # Not "until it is 1": in a container or a session manager, orphans can be given to another process.
        while os.getppid() == parent:
            time.sleep(_PARENT_CHECK_SECONDS)
        clean_up()
        os._exit(EXIT_INCOMPLETE)

    threading.Thread(target=watch, daemon=True).start()


def _note(_signal: int, _frame: FrameType | None) -> None:
    global _came
    _came = True
    raise KeyboardInterrupt


def _report_others(lost: "sys.UnraisableHookArgs") -> None:
    if lost.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(lost)
