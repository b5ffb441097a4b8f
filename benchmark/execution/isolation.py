"""Run a job in a process of its own, so that a failing model loses only its own results."""

import json
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol, runtime_checkable

from benchmark.execution.machine import ROOT, cores, machine_mib, resident_mib
from datagen.console.text import counted
from datagen.errors import EXIT_INTERRUPTED, Busy

LOGS = "logs"
MEMORY_SHARE = 0.9
"""Share of the machine's memory that all jobs together may use."""
_POLL_SECONDS = 0.05
SAVING_SECONDS = 5.0
"""Grace period between SIGTERM and SIGKILL, in which a model may save its state."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@runtime_checkable
class Work(Protocol):
    """Work for a process of its own: such as `benchmark.execution.runner.Job`."""

    @property
    def results(self) -> tuple[str, ...]:
        """Names of the results that it writes."""
        ...

    def run(self, announce: Callable[[str], None]) -> None:
        """Do the work; calls `announce` with each of `results` once it is written, and may announce "fitted" before."""
        ...


@dataclass(frozen=True)
class Limits:
    """Resources that a job may use."""

    seconds: float
    """Time limit until the next result is written, fitting included."""
    memory_mib: float
    """Limit of the process's resident memory."""
    threads: int = 1


def limits(seconds: float, *, workers: int, memory_mib: float | None = None, threads: int | None = None) -> Limits:
    """Limits of one of `workers` parallel jobs: an equal part of the machine, unless given otherwise."""
    return Limits(
        seconds=seconds,
        memory_mib=memory_mib or MEMORY_SHARE * machine_mib() / workers,
        threads=threads or max(1, cores() // workers),
    )


@dataclass(frozen=True)
class Outcome:
    """Ending of a job: its events, and the reason of a failure."""

    events: tuple[str, ...]
    """Events that the job announced, in order."""
    reason: str
    """Why it did not finish; empty if it did."""


def run_isolated(job: Work, limits: Limits, log: Path, stop: threading.Event, heard: Callable[[str], None]) -> Outcome:
    """Run a job in its own process. It calls `heard` with each event; setting `stop` ends it. A failure leaves a log.

    Raises:
        Busy: another process already does this work; nothing is wrong with the job.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as errors:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "benchmark.execution.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=_environment(limits.threads),
            start_new_session=True,
        )
        try:
            outcome = _watch(process, job, limits, stop, heard)
        finally:
            _kill(process)
    if not outcome.reason or log.stat().st_size == 0:
        log.unlink()
    return outcome


def _watch(
    process: subprocess.Popen[bytes], job: Work, limits: Limits, stop: threading.Event, heard: Callable[[str], None]
) -> Outcome:
    assert process.stdin
    assert process.stdout
    with suppress(BrokenPipeError), process.stdin as pipe:
        pickle.dump((os.getpid(), job), pipe)
    lines: queue.Queue[bytes | None] = queue.Queue()
    threading.Thread(target=_read, args=(process.stdout, lines), daemon=True).start()
    events: list[str] = []
    deadline = time.monotonic() + limits.seconds
    while True:
        try:
            line = lines.get(timeout=_POLL_SECONDS)
        except queue.Empty:
            if reason := _trespass(process, limits, deadline, stop):
                return Outcome(tuple(events), reason)
            continue
        if line is None:
            done = set(job.results) <= set(events)
            return Outcome(tuple(events), _ending(process.wait(), done))
        event = json.loads(line)
        if "busy" in event:
            raise Busy(event["busy"])
        if "failed" in event:
            return Outcome(tuple(events), event["failed"])
        events.append(event["done"])
        heard(event["done"])
        deadline = deadline if event["done"] == "fitted" else time.monotonic() + limits.seconds


def _read(stream: IO[bytes], lines: "queue.Queue[bytes | None]") -> None:
    with stream:
        for line in stream:
            lines.put(line)
    lines.put(None)


def _trespass(process: subprocess.Popen[bytes], limits: Limits, deadline: float, stop: threading.Event) -> str:
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
    if code == EXIT_INTERRUPTED:
        return "interrupted"
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


def _environment(threads: int) -> dict[str, str]:
    """Environment of the process: the import paths of this one, and the given number of threads."""
    paths = os.pathsep.join(dict.fromkeys([str(ROOT), *filter(None, sys.path)]))
    return {**os.environ, "PYTHONPATH": paths, **dict.fromkeys(_THREADS, str(threads))}
