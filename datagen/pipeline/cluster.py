"""Map work items over an existing Dask cluster; Dask queues, retries and moves them. The only import of Dask."""

import logging
import os
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from math import inf
from pathlib import Path
from typing import Any, TypeVar

from datagen.errors import Busy, DatagenError, UsageError
from datagen.storage.atomic import temporary_path

RETRIES = 2
"""Number of times that an item is tried again after an exception that the user cannot fix, or `Busy`; Dask counts lost
workers apart."""
_POLL_SECONDS = 0.1
"""Interval at which `Cluster.call` looks for a result or `stop`, and time limit of `Kept.read`."""

Item = TypeVar("Item")
Result = TypeVar("Result")


class Cluster:
    """A connection to a Dask scheduler, see `connected`; its methods may be called in any thread."""

    def __init__(self, client: Any, address: str):
        self._client, self._address = client, address

    def map(self, do: Callable[..., Result], items: Sequence[Item], **shared: Any) -> Iterator[tuple[Item, Result]]:
        """Call `do(item, **shared)` on the workers, and yield each item with its result as soon as it is there.

        Raises:
            DatagenError: an item failed for good, or the scheduler is gone; the other results are lost.
        """
        from distributed import as_completed

        with self._explained():
            futures = self._client.map(_attempt, items, do=do, pure=False, retries=RETRIES, batch_size=10_000, **shared)
            item_of = {future.key: item for future, item in zip(futures, items, strict=True)}
            finished = as_completed(futures, loop=self._client.loop, with_results=True)
            # The cluster drops a result as soon as nothing here refers to its future.
            del futures
            for future, result in finished:
                if future.cancelled():
                    raise CancelledError
                yield item_of.pop(future.key), _success(result)
            if item_of:  # the client has closed itself
                raise CancelledError

    def call(self, do: Callable[..., Result], *arguments: Any, stop: threading.Event) -> Result | None:
        """Call `do(*arguments)` on a worker and wait for its result; None once `stop` is set. Raises as `map`."""
        with self._explained():
            future = self._client.submit(_attempt, *arguments, do=do, pure=False, retries=RETRIES)
            while not future.done():
                if stop.wait(_POLL_SECONDS):
                    future.cancel()
                    return None
            return _success(future.result())

    def keep(self, name: str) -> "Kept":
        """Files that the scheduler holds under a name."""
        return Kept(name, self._client)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        from distributed import KilledWorker
        from distributed.comm.core import CommClosedError

        advice = "Finished work is kept; run the same command again to continue."
        try:
            yield
        except (CancelledError, CommClosedError):
            raise DatagenError(f"The Dask scheduler at {self._address} is gone or was restarted. {advice}") from None
        except KilledWorker as error:
            raise DatagenError(
                f"{error.task} was given up, because several workers died while they ran it, perhaps because memory "
                f"ran out. {advice}"
            ) from None
        except ImportError as error:
            raise DatagenError(
                f"A Dask worker lacks a package ({error}); install the same version of obpose there as here."
            ) from None


def _attempt(*arguments: Any, do: Callable[..., Result], **shared: Any) -> Result | DatagenError:
    """Do a work item on a worker; errors that would come again are returned, so that Dask does not retry them."""
    try:
        return do(*arguments, **shared)
    except Busy:
        raise
    except DatagenError as error:
        return error


def _success(result: Result | DatagenError) -> Result:
    if isinstance(result, DatagenError):
        raise result
    return result


class Cancellation(threading.Event):
    """Event that is set once Dask has no use for the task that made it: its client has cancelled it, or is gone."""

    def __init__(self):
        from distributed import get_worker

        super().__init__()
        worker = get_worker()
        self._task = worker.state.tasks[worker.get_current_task()]

    def is_set(self) -> bool:
        """Whether the task is cancelled."""
        return self._task.state == "cancelled"


class Kept:
    """Files that a scheduler holds under a name, so that they outlive workers and clients."""

    def __init__(self, name: str, client: Any = None):
        from distributed import Variable, get_client

        # A task has a client of its own.
        self._variable = Variable(name, client or get_client())

    def read(self) -> dict[str, bytes]:
        """The files; none if the scheduler holds none."""
        try:
            files: Any = self._variable.get(timeout=_POLL_SECONDS)
        except TimeoutError:
            return {}
        return files

    def write(self, files: Mapping[str, bytes]) -> None:
        """Replace the files."""
        self._variable.set(dict(files))


def memory_share() -> float:
    """Bytes that each thread of this worker may use."""
    from distributed import get_worker

    worker = get_worker()
    return (worker.memory_manager.memory_limit or inf) / worker.state.nthreads


@contextmanager
def connected(address: str, *, seconds: float = 30) -> Iterator[Cluster]:
    """Connect to the scheduler at an address such as `tcp://host:8786`, which has to answer within `seconds`.

    Raises:
        UsageError: Dask is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
        from distributed.comm.addressing import get_address_host
    except ImportError:
        raise UsageError("--dask needs dask.distributed; install it with: pip install 'obpose[dask]'") from None
    # Its records of lost connections come with tracebacks; commands report them in one line.
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        get_address_host(address)  # after a malformed address, a client would hang at its end
        client = Client(address, timeout=seconds, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise UsageError(
            f"--dask {address!r}: no scheduler answers there ({reason:.200}). Start one with `dask scheduler`, and "
            "give the address that it prints."
        ) from None
    try:
        yield Cluster(client, address)
    finally:
        client.close(timeout=seconds)


def refresh_mark(mark: Path) -> None:
    """Make a mark look new, because other hosts delete temporary files that are old."""
    with suppress(FileNotFoundError):
        os.utime(mark)


@contextmanager
def shared_mark(folder: Path) -> Iterator[Path]:
    """Yield the path of an empty file in a folder: a worker that sees it shares the folder with this process."""
    mark = temporary_path(folder.resolve() / f"cluster-{uuid.uuid4().hex}")
    mark.touch()
    try:
        yield mark
    finally:
        with suppress(OSError):
            os.unlink(mark)
