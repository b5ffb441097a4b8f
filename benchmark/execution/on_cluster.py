"""Run jobs on the workers of a Dask cluster, each in a process of its own with limits."""

import dataclasses
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmark.execution.executor import SAVING_SECONDS, Limits, Outcome, Runnable, run_isolated, running_jobs_by
from datagen.errors import Busy, UsageError
from datagen.pipeline.cluster import Cancellation, Kept, connected, memory_share, refresh_mark, shared_mark
from datagen.storage.atomic import write_atomically


@contextmanager
def on_cluster(address: str, out: Path) -> Iterator[None]:
    """Make `run_jobs` run all jobs on the cluster; results come back where workers do not share the folder `out`.

    Raises:
        UsageError: no scheduler answers at this address.
    """
    out.mkdir(parents=True, exist_ok=True)
    with connected(address) as cluster, shared_mark(out) as mark:

        def run(job: Runnable, limits: Limits, stop: threading.Event, on_event: Callable[[str], None]) -> Outcome:
            job = with_paths(job, Path.absolute)
            # A task that Dask repeats, and a repeated command, resume from the newest state.
            kept = cluster.keep(f"obpose {job.state[0]}") if job.state else None
            if kept and not kept.read():
                kept.write(_read(job.out, job.state))
            refresh_mark(mark)
            made = cluster.call(run_remotely, job, limits, mark, stop=stop)
            outcome, files = made or (Outcome((), "interrupted"), {})
            _write(job.out, files)
            if kept and made:
                kept.write({})  # not deleted, which would take effect later
            for event in outcome.events:
                on_event(event)
            return outcome

        with running_jobs_by(run):
            yield


def run_remotely(job: Runnable, limits: Limits, mark: Path) -> tuple[Outcome, Mapping[str, bytes]]:
    """Run a job on a worker; returns the files that it wrote unless the worker shares the run folder, see `mark`.

    Raises:
        UsageError: the worker does not see a dataset or another file of the job.
    """

    def check(path: Path) -> Path:
        if not (path.is_relative_to(job.out) or path.exists()):
            raise UsageError(f"A Dask worker does not see {path}; put it into a folder that all machines share.")
        return path

    with_paths(job, check)
    limits = dataclasses.replace(limits, memory_mib=min(limits.memory_mib, memory_share() / 2**20))
    # A worker that shares the run folder works in it.
    if mark.exists():
        return _run(job, limits), {}
    # Other workers work in a copy, and continue the state that an earlier worker left with the scheduler.
    with TemporaryDirectory() as place:
        folder = Path(place)
        moved = with_paths(
            job, lambda path: folder / path.relative_to(job.out) if path.is_relative_to(job.out) else path
        )
        kept = Kept(f"obpose {job.state[0]}") if job.state else None
        _write(folder, kept.read() if kept else {})
        with _copying(folder, moved.state, kept) if kept else nullcontext():
            outcome = _run(moved, limits)
        return outcome, _read(folder, [folder])


@contextmanager
def _copying(folder: Path, state: Sequence[Path], kept: Kept, *, every_seconds: float = 30) -> Iterator[None]:
    """Copy the files of a job's state to the scheduler again and again, once they have changed.

    A lost worker loses the training since the last copied checkpoint.
    """
    ended, copied = threading.Event(), _read(folder, state)

    def copy() -> None:
        nonlocal copied
        files = _read(folder, state)
        if files != copied:
            kept.write(files)
            copied = files

    def repeat() -> None:
        while not ended.wait(every_seconds):
            copy()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        copy()


def _read(root: Path, places: Iterable[Path]) -> dict[str, bytes]:
    """Content of files and of the files in folders, by their names below a folder, temporary ones aside."""
    paths = (path for place in places for path in (place, *place.rglob("[!.]*")))
    files = {}
    for path in paths:
        with suppress(FileNotFoundError, IsADirectoryError):
            files[str(path.relative_to(root))] = path.read_bytes()
    return files


def _write(root: Path, files: Mapping[str, bytes]) -> None:
    for name, content in files.items():
        write_atomically(root / name, content)


def _run(job: Runnable, limits: Limits) -> Outcome:
    try:
        return run_isolated(job, limits, Cancellation(), lambda event: None)
    except Busy:
        # The process of a lost worker may still be saving its state; Dask tries again.
        time.sleep(2 * SAVING_SECONDS)
        raise


def with_paths(value: Any, change: Callable[[Path], Path]) -> Any:
    """Copy of a job with changed paths, those of nested dataclasses included."""
    if isinstance(value, Path):
        return change(value)
    if isinstance(value, tuple):
        return tuple(with_paths(part, change) for part in value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: with_paths(getattr(value, field.name), change) for field in dataclasses.fields(value)}
        return dataclasses.replace(value, **fields)
    return value
