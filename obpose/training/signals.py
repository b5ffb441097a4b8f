"""Stop between two steps on SIGTERM or SIGINT."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGTERM, signal.SIGINT)


class StopRequest:
    """Request to stop, and its signal."""

    received: signal.Signals | None = None
    when: float = 0.0
    """Monotonic time of the signal, seconds."""


@contextmanager
def stop_on_signals(*, echo_seconds: float = 1.0) -> Iterator[StopRequest]:
    """Record SIGTERM and SIGINT instead of exiting; a later signal has its usual effect.

    A second signal within `echo_seconds` belongs to the same request, because shells and `torchrun` forward signals.
    Python allows this in the main thread only; in other threads nothing is changed.
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
        if request.received and time.monotonic() - request.when > echo_seconds:
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
