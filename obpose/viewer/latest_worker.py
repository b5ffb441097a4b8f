"""A worker thread that serves only the latest request and cancels superseded ones midway.

While an object is dragged, requests come faster than they can be rendered. The worker splits each request into chunks
and checks for a newer request between two chunks.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

Request = TypeVar("Request")
Chunk = TypeVar("Chunk")


class LatestWorker(Generic[Request, Chunk]):
    """A thread that makes the chunks of the latest request, and runs jobs in between."""

    def __init__(
        self,
        make: Callable[[Request], Iterator[Chunk]],
        deliver: Callable[[Request, Chunk], None],
        on_error: Callable[[Exception], None],
    ):
        """Start the thread; it calls all three, and `on_error` with every exception of the others and of jobs."""
        self._make, self._deliver, self._on_error = make, deliver, on_error
        self._latest: Request | None = None
        self._current: tuple[Request, Iterator[Chunk]] | None = None
        self._jobs: deque[Callable[[], None]] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self._busy = False
        self._thread = threading.Thread(target=self._work, name="latest-worker", daemon=True)
        self._thread.start()

    def request(self, request: Request) -> None:
        """Start on this request and cancel the previous one."""
        with self._changed:
            self._latest = request
            self._changed.notify_all()

    def run(self, job: Callable[[], None]) -> None:
        """Run a job in the thread after the current chunk; jobs are never cancelled."""
        with self._changed:
            self._jobs.append(job)
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until the thread is idle; false if that takes longer."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._busy or self._has_work()), seconds)

    def close(self) -> None:
        """End the thread after the current chunk, and drop all other work."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _work(self) -> None:
        while (step := self._next_step()) is not None:
            try:
                step()
            except Exception as error:
                self._on_error(error)

    def _next_step(self) -> Callable[[], None] | None:
        """Wait for a job, a request or the next chunk, in this order of priority; None to end."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(self._has_work)
            self._busy = True
            if self._closed:
                return None
            if self._jobs:
                return self._jobs.popleft()
            if self._latest is not None:
                self._current, self._latest = (self._latest, self._make(self._latest)), None
            return self._advance

    def _advance(self) -> None:
        """Make and deliver the next chunk; after an error or the last chunk, the request is done."""
        assert self._current is not None
        request, chunks = self._current
        self._current = None
        for chunk in chunks:
            self._deliver(request, chunk)
            self._current = request, chunks
            return

    def _has_work(self) -> bool:
        return self._closed or bool(self._jobs) or self._latest is not None or self._current is not None
