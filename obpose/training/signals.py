"""Stopping between two steps when the process is asked to end."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGTERM, signal.SIGINT)
ECHO_SECONDS = 1.0
"""Another signal within this time is the same request: shells, schedulers and `torchrun` pass on what came already."""


class StopRequest:
    """Whether and how somebody asked to stop."""

    received: signal.Signals | None = None
    when: float = 0.0
    """Seconds, of the clock that only goes forward."""


@contextmanager
def stop_on_signals() -> Iterator[StopRequest]:
    """Take note of SIGTERM and SIGINT in the place of dying; a later one has its usual effect.

    Python lets only the main thread do so; elsewhere nothing is changed.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def note(number: int, _frame: FrameType | None) -> None:
        if request.received and time.monotonic() - request.when > ECHO_SECONDS:
            restore()
            signal.raise_signal(number)
        elif not request.received:
            request.received, request.when = signal.Signals(number), time.monotonic()

    for number in SIGNALS:
        signal.signal(number, note)
    try:
        yield request
    finally:
        restore()
