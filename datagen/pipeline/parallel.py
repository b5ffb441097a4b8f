"""Make or check scenes in several processes, and yield the results in order.

Each worker has a socket of its own. The pools of joblib and the standard library share one pipe for all results: if a
worker is killed while it sends one, they wait forever for the rest of it.
"""

import os
import queue
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from multiprocessing.connection import Connection, Pipe
from typing import Any, TypeVar

from datagen.console import interrupts
from datagen.errors import DatagenError

Place = TypeVar("Place")
Made = TypeVar("Made")

_AHEAD = 2
"""Results per worker that may wait for the caller."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def make_all(make: Callable[[str, Place], Made], scenes: Sequence[tuple[str, Place]], workers: int) -> Generator[Made]:
    """Call `make` on splits and indices; yields the results in their order.

    Args:
        make: A picklable function. Other processes import its module by name.
        scenes: Splits and indices.
        workers: Number of processes; with one, or fewer than three scenes, this process makes all.

    Raises:
        DatagenError: a worker died.
        Exception: whatever `make` raises.
    """
    if workers == 1 or len(scenes) < 3:
        for scene in scenes:
            interrupts.check()
            yield make(*scene)
        return
    # The first scene compiles and caches the renderer, so that the workers do not all compile it.
    yield make(*scenes[0])
    interrupts.check()
    workers = min(workers, len(scenes) - 1)
    with _started_workers(make, workers) as ask:
        pending: deque[Future[Made]] = deque()
        for scene in scenes[1:]:
            pending.append(ask(scene))
            if len(pending) == _AHEAD * workers:
                yield _result(pending.popleft())
        while pending:
            yield _result(pending.popleft())


def environment(threads: int) -> dict[str, str]:
    """Environment of a worker: the import paths of this process, and the given number of threads."""
    paths = os.pathsep.join(map(os.path.abspath, sys.path))
    return {**os.environ, "PYTHONPATH": paths, **dict.fromkeys(_THREADS, str(threads))}


@contextmanager
def _started_workers(make: Callable[..., Any], count: int) -> Iterator[Callable[[tuple[str, Any]], "Future[Any]"]]:
    """Start workers, give a function that has the next free one make a scene, and kill them at the end."""
    processes: list[subprocess.Popen[bytes]] = []
    free: queue.SimpleQueue[Connection] = queue.SimpleQueue()

    def ask(scene: tuple[str, Any]) -> Any:
        connection = free.get()
        try:
            connection.send(scene)
            made, error = connection.recv()
        except (EOFError, OSError):
            raise DatagenError(
                "A worker process died, perhaps because memory ran out. Finished shards are intact; "
                "run the same command again, perhaps with fewer --workers."
            ) from None
        finally:
            free.put(connection)
        if error:
            raise error
        return made

    # A thread for each worker receives its results while the caller is busy.
    with ThreadPoolExecutor(count) as threads:
        try:
            with interrupts.held():
                for _ in range(count):
                    process, connection = _start(make)
                    processes.append(process)
                    free.put(connection)
            yield lambda scene: threads.submit(ask, scene)
        finally:
            for process in processes:
                process.kill()
            threads.shutdown(cancel_futures=True)
            for process in processes:
                process.wait()
            while not free.empty():
                free.get().close()


def _start(make: Callable[..., Any]) -> tuple[subprocess.Popen[bytes], Connection]:
    ours, theirs = Pipe()
    with closing(theirs):
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "datagen.pipeline.worker", str(theirs.fileno()), str(os.getpid())],
            stdin=subprocess.DEVNULL,
            env=environment(threads=1),
            pass_fds=[theirs.fileno()],
        )
    with suppress(OSError):  # it has died, which is noticed when it is asked for a scene
        ours.send(make)
    return process, ours


def _result(future: "Future[Made]") -> Made:
    made = future.result()
    interrupts.check()
    return made
