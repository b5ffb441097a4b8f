"""Make or check scenes in several processes, and yield the results in order."""

import os
import signal
import sys
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, TypeVar

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.backend import resource_tracker as loky_tracker
from joblib.externals.loky.process_executor import TerminatedWorkerError

from datagen.console import interrupts
from datagen.errors import DatagenError

Place = TypeVar("Place")
Made = TypeVar("Made")


def make_all(make: Callable[[str, Place], Made], scenes: Sequence[tuple[str, Place]], workers: int) -> Generator[Made]:
    """Call `make`, which must be picklable, on splits and indices; yields the results in their order."""
    if workers == 1 or len(scenes) < 3:
        for scene in scenes:
            interrupts.check()
            yield make(*scene)
        return
    # The first scene compiles and caches the renderer, so that the workers do not all compile it.
    yield make(*scenes[0])
    interrupts.check()
    with parallel_config(backend="loky", inner_max_num_threads=1, initializer=_become_worker, initargs=(os.getpid(),)):
        pool: Any = Parallel(
            n_jobs=min(workers, len(scenes) - 1),
            batch_size=1,  # pyright: ignore[reportArgumentType]  # joblib takes numbers too
            return_as="generator",
            max_nbytes=None,
        )
    with _silent_trackers(), interrupts.held():
        made = pool(delayed(make)(*scene) for scene in scenes[1:])
    try:
        for scene in made:  # `yield from` would close it before the warnings are disabled
            interrupts.check()
            yield scene
    except TerminatedWorkerError:
        raise DatagenError(
            "A worker process died, perhaps because memory ran out. Finished shards are intact; "
            "run the same command again, perhaps with fewer --workers."
        ) from None
    finally:
        _stop(made)


@contextmanager
def _silent_trackers() -> Iterator[None]:
    """Start joblib's resource trackers with their warnings disabled.

    After Ctrl-C they would warn of leaked semaphores or folders, although they remove them.
    """
    sys.warnoptions.append("ignore:resource_tracker:UserWarning")  # handed to every process that is started
    try:
        loky_tracker.ensure_running()
        resource_tracker.ensure_running()  # when it starts, it lets Ctrl-C through again
        yield
    finally:
        sys.warnoptions.pop()


def _stop(made: Generator[Any]) -> None:
    """Stop the workers, without joblib's warning about unused results."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        made.close()


def _become_worker(parent: int) -> None:
    """Ignore Ctrl-C, which the parent handles, and exit when the parent is gone, even if it was killed.

    This runs before a worker waits for its first task. Otherwise a worker whose parent was killed would wait for
    minutes, or forever if the parent held a lock, and keep the parent's output pipes open.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    interrupts.end_with(parent)
