"""Work that is always about the newest wish: a thread that drops what was overtaken, also half done.

While an object is dragged wishes come faster than pictures are rendered. Each wish is worked on piece by piece; between
two pieces the thread looks whether there is a newer one.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

Wish = TypeVar("Wish")
Piece = TypeVar("Piece")


class Newest(Generic[Wish, Piece]):
    """A thread that makes pieces of the newest wish, and runs other jobs in between."""

    def __init__(
        self,
        make: Callable[[Wish], Iterator[Piece]],
        deliver: Callable[[Wish, Piece], None],
        failed: Callable[[Exception], None],
    ):
        """All three are called in the thread; `failed` with whatever the others and jobs raise."""
        self._make, self._deliver, self._failed = make, deliver, failed
        self._wish: Wish | None = None
        self._jobs: deque[Callable[[], None]] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self._busy = False
        self._thread = threading.Thread(target=self._work, name="newest", daemon=True)
        self._thread.start()

    def wish(self, wish: Wish) -> None:
        """Begin with this; what was begun before and is not done is dropped."""
        with self._changed:
            self._wish = wish
            self._changed.notify_all()

    def run(self, job: Callable[[], None]) -> None:
        """Run something in the same thread as soon as a piece is done; jobs are never dropped."""
        with self._changed:
            self._jobs.append(job)
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until nothing is left to do, and say whether that came to be."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._busy or self._is_overtaken()), seconds)

    def close(self) -> None:
        """End the thread once its piece is done; wishes and jobs that are left are dropped."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _work(self) -> None:
        while (task := self._next()) is not None:
            try:
                task()
            except Exception as error:
                self._failed(error)

    def _next(self) -> Callable[[], None] | None:
        """A job, or to work on the wish; None to end."""
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(self._is_overtaken)
            if self._closed:
                return None
            self._busy = True
            if self._jobs:
                return self._jobs.popleft()
            wish, self._wish = self._wish, None
            assert wish is not None
            return lambda: self._fulfil(wish)

    def _fulfil(self, wish: Wish) -> None:
        for piece in self._make(wish):
            self._deliver(wish, piece)
            while job := self._next_job():
                job()
            if self._is_overtaken():
                return

    def _next_job(self) -> Callable[[], None] | None:
        with self._changed:
            return self._jobs.popleft() if self._jobs else None

    def _is_overtaken(self) -> bool:
        return self._wish is not None or bool(self._jobs) or self._closed
