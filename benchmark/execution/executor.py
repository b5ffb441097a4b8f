"""Run jobs in processes of their own, within limits of time and memory.

A job that crashes, hangs or uses too much memory loses only its own results. No library is used: the pools of joblib
and Pebble limit neither memory nor the processes that a model starts itself.
"""

import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol, TypeVar, runtime_checkable

from benchmark.machine import cores, machine_mib, resident_mib
from datagen.console.text import counted
from datagen.errors import Busy
from datagen.pipeline.parallel import environment

LOGS = "logs"
MEMORY_SHARE = 0.9
"""Share of the machine's memory that all jobs together may use."""
SAVING_SECONDS = 5.0
"""Grace period between SIGTERM and SIGKILL, in which a model may save its state."""
FITTED = "fitted"
"""Event that a job may announce before its results; it does not extend the time limit."""
_POLL_SECONDS = 0.05


@runtime_checkable
class Runnable(Protocol):
    """Picklable work with named results, such as `benchmark.execution.jobs.Job`."""

    @property
    def out(self) -> Path:
        """The run folder, which gets a log if the job fails."""
        ...

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results that it writes; the first also names the log."""
        ...

    @property
    def state(self) -> tuple[Path, ...]:
        """Files and folders in the run folder from which it resumes after an interruption."""
        ...

    def run(self, announce: Callable[[str], None]) -> None:
        """Do the work. Calls `announce` with each of `results` once it is written; other events are allowed, too."""
        ...


@dataclass(frozen=True)
class Limits:
    """Resources that a job may use."""

    seconds: float
    """Time limit until the next result is written, fitting included."""
    memory_mib: float
    """Limit of the process's resident memory."""
    threads: int = 1


@dataclass(frozen=True)
class Outcome:
    """Ending of a job: its events, and the reason of a failure."""

    events: tuple[str, ...]
    """Events that the job announced, in order."""
    reason: str
    """Reason of the failure; empty if the job finished."""


Work = TypeVar("Work", bound=Runnable)
Runner = Callable[[Runnable, Limits, threading.Event, Callable[[str], None]], Outcome]
"""Runs one job: takes the job, its limits, an event that ends it, and a function to call with each announced event."""


def limits(seconds: float, *, workers: int, memory_mib: float | None = None, threads: int | None = None) -> Limits:
    """Limits of one of `workers` parallel jobs: an equal part of the machine, unless given otherwise."""
    return Limits(
        seconds=seconds,
        memory_mib=memory_mib or MEMORY_SHARE * machine_mib() / workers,
        threads=threads or max(1, cores() // workers),
    )


def run_jobs(
    jobs: Sequence[Work],
    limits_of: Callable[[Work], Limits],
    workers: int,
    *,
    on_event: Callable[[Work, str], None],
    on_failure: Callable[[Work, Outcome], Sequence[Work]],
) -> None:
    """Run jobs in order, `workers` at a time. Results that are already written survive a kill at any moment.

    Args:
        jobs: The jobs.
        limits_of: Gives the limits of a job.
        workers: Number of jobs that run in parallel.
        on_event: Called with every event that a job announces.
        on_failure: Called with a job that ended without all of its results; returns what is to be tried next.

    Raises:
        Busy: another process does the work of a job. The other running jobs are stopped first.
        BaseException: whatever interrupts this function, Ctrl-C included, once the running jobs have ended.
    """
    stop, run = threading.Event(), _runner.get()

    def do(job: Work) -> Sequence[Work]:
        outcome = run(job, limits_of(job), stop, lambda event: on_event(job, event))
        return [] if stop.is_set() or {*job.results} <= {*outcome.events} else on_failure(job, outcome)

    waiting, running = list(jobs), set()
    with ThreadPoolExecutor(workers) as pool:
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    running.add(pool.submit(do, waiting.pop(0)))
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                waiting[:0] = [rest for future in finished for rest in future.result()]
        except BaseException:
            stop.set()
            raise


def run_isolated(job: Runnable, limits: Limits, stop: threading.Event, on_event: Callable[[str], None]) -> Outcome:
    """Run a job in its own process. A failure leaves a log.

    Raises:
        Busy: another process already does this work; nothing is wrong with the job.
    """
    log = job.out / LOGS / f"{job.results[0]}.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    # A session of its own, so that all processes of the job can be killed together.
    with log.open("wb") as errors:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "benchmark.execution.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=environment(limits.threads),
            start_new_session=True,
        )
        try:
            outcome = _supervise(process, job, limits, stop, on_event)
        finally:
            _kill(process)
    # Keep the log of failures only.
    with suppress(FileNotFoundError):  # another command that makes the same row may have removed it
        if not outcome.reason or log.stat().st_size == 0:
            log.unlink()
    return outcome


_runner: ContextVar[Runner] = ContextVar("runner", default=run_isolated)


@contextmanager
def running_jobs_by(run: Runner) -> Iterator[None]:
    """Make `run_jobs` run its jobs by this function."""
    token = _runner.set(run)
    try:
        yield
    finally:
        _runner.reset(token)


def _supervise(
    process: subprocess.Popen[bytes],
    job: Runnable,
    limits: Limits,
    stop: threading.Event,
    on_event: Callable[[str], None],
) -> Outcome:
    """Pass the job to its process, and follow its events until it ends or exceeds a limit."""
    assert process.stdin
    assert process.stdout
    # The job goes in by standard input; events come out line by line, read by a thread.
    with suppress(BrokenPipeError), process.stdin as pipe:
        pickle.dump((os.getpid(), job), pipe)
    lines: queue.Queue[bytes | None] = queue.Queue()
    threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
    events: list[str] = []
    deadline = time.monotonic() + limits.seconds
    while True:
        try:
            line = lines.get(timeout=_POLL_SECONDS)
        # Limits are checked while there is nothing to read.
        except queue.Empty:
            if process.poll() is not None:
                _kill(process)  # children that the model has forked keep the pipe open after a crash
            if reason := _exceeded_limit(process, limits, deadline, stop):
                return Outcome(tuple(events), reason)
            continue
        # The process has ended.
        if line is None:
            done = set(job.results) <= set(events)
            return Outcome(tuple(events), _ending(process.wait(), done))
        message = json.loads(line)
        if "busy" in message:
            raise Busy(message["busy"])
        if "failed" in message:
            return Outcome(tuple(events), message["failed"])
        event = message["done"]
        events.append(event)
        on_event(event)
        deadline = deadline if event == FITTED else time.monotonic() + limits.seconds


def _read(stream: IO[bytes], lines: "queue.Queue[bytes | None]") -> None:
    with stream:
        for line in stream:
            lines.put(line)
    lines.put(None)


def _exceeded_limit(process: subprocess.Popen[bytes], limits: Limits, deadline: float, stop: threading.Event) -> str:
    """Name the limit that the process exceeds; empty if none."""
    if stop.is_set():
        return "interrupted"
    if time.monotonic() > deadline:
        return f"took longer than the time limit of {counted(limits.seconds / 60, 'minute')}"
    used = resident_mib(process.pid)
    return f"out of memory: {used:.0f} MiB of {limits.memory_mib:.0f} MiB" if used > limits.memory_mib else ""


def _ending(code: int, done: bool) -> str:
    if code == 0 and done:
        return ""
    if code == -signal.SIGKILL:
        return "was killed, most likely because memory ran out"
    if code < 0:
        return f"crashed with {signal.Signals(-code).name}"
    return f"its process ended by itself with exit code {code} before it returned a result"


def _kill(process: subprocess.Popen[bytes]) -> None:
    """End the process and its children, after a grace period in which a model may save its state."""
    if process.poll() is None:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(SAVING_SECONDS)
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
