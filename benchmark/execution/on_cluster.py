"""Run jobs on the workers of a Dask cluster, each in a process of its own with limits."""

import dataclasses
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmark.execution.executor import SAVING_SECONDS, Limits, Outcome, Runnable, run_isolated, running_jobs_by
from datagen.errors import Busy, UsageError
from datagen.pipeline.cluster import Cancellation, connected, memory_share, shared_mark
from datagen.storage.atomic import write_atomically


@contextmanager
def on_cluster(address: str, out: Path) -> Iterator[None]:
    """Make `run_jobs` run all jobs on the cluster; results come back where workers do not share the folder `out`."""
    out.mkdir(parents=True, exist_ok=True)
    with connected(address) as cluster, shared_mark(out) as mark:

        def run(job: Runnable, limits: Limits, stop: threading.Event, on_event: Callable[[str], None]) -> Outcome:
            job = with_paths(job, Path.absolute)
            outcome, files = cluster.call(run_remotely, job, limits, mark, stop=stop) or (
                Outcome((), "interrupted"),
                {},
            )
            for name, content in files.items():
                write_atomically(job.out / name, content)
            for event in outcome.events:
                on_event(event)
            return outcome

        with running_jobs_by(run):
            yield


def run_remotely(job: Runnable, limits: Limits, mark: Path) -> tuple[Outcome, Mapping[str, bytes]]:
    """Run a job on a worker; returns the files that it wrote unless the worker shares the run folder, see `mark`."""

    def check(path: Path) -> Path:
        if not (path.is_relative_to(job.out) or path.exists()):
            raise UsageError(f"A Dask worker does not see {path}; put it into a folder that all machines share.")
        return path

    with_paths(job, check)
    limits = dataclasses.replace(limits, memory_mib=min(limits.memory_mib, memory_share() / 2**20))
    if mark.exists():
        return _run(job, limits), {}
    with TemporaryDirectory() as place:
        moved = with_paths(
            job, lambda path: place / path.relative_to(job.out) if path.is_relative_to(job.out) else path
        )
        outcome = _run(moved, limits)
        files = {str(path.relative_to(place)): path.read_bytes() for path in Path(place).rglob("*") if path.is_file()}
    return outcome, files


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
