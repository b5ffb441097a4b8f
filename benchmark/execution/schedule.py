"""Doing a plan: datasets first, then jobs side by side, each in its own process, each row written when it is known."""

import dataclasses
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from pathlib import Path
from typing import TypeVar

from benchmark.execution.isolation import LOGS, Limits, run_isolated
from benchmark.execution.plan import Plan, repeats
from benchmark.execution.runner import Job, Target, blank_row
from benchmark.models.model_spec import ModelSpec
from benchmark.models.registry import find_model
from benchmark.results.run_folder import SCENES, RunKey, RunRow, load_row, load_runs, row_path, save_row
from datagen.storage.atomic import write_atomically

Heard = Callable[[RunRow], None]
"""Is told of every target's row that a job made or failed to make."""
Task = TypeVar("Task")


def run_jobs(plan: Plan, limits_of: Callable[[Job], Limits], workers: int, heard: Heard) -> None:
    """Do all jobs of a plan. Kill it at any moment: the rows that were written count, the others are made next time.

    Raises:
        Busy: another process makes one of them; those at work beside it were ended, and go on the next time.
    """
    side_by_side(plan.jobs, lambda job, stop: _do(job, limits_of(job), stop, heard), workers)


def side_by_side(tasks: Sequence[Task], do: Callable[[Task, threading.Event], Sequence[Task]], workers: int) -> None:
    """Do so many tasks at a time, in their order; `do` returns what is left of one, and ends early when it is told to.

    Whatever interrupts this, Ctrl-C included, is raised when the running tasks have ended.
    """
    stop = threading.Event()
    waiting = list(tasks)
    with ThreadPoolExecutor(workers) as pool:
        try:
            running = set()
            while waiting or running:
                while waiting and len(running) < workers:
                    running.add(pool.submit(do, waiting.pop(0), stop))
                finished, running = wait(running, return_when=FIRST_COMPLETED)
                waiting[:0] = [rest for future in finished for rest in future.result()]
        except BaseException:
            stop.set()
            raise


def repeat_rows(keys: Sequence[RunKey], out: Path) -> None:
    """Write the rows of the seeds that were not run because seeds make no difference to their models."""
    rows = load_runs(out)
    there = {row.key for row in rows}
    for row in rows:
        for twin in repeats(row, keys):
            if twin.key not in there:
                _copy_scenes(out, row.key, twin.key)
                save_row(out, twin)


def _copy_scenes(out: Path, old: RunKey, new: RunKey) -> None:
    table = out / SCENES / f"{old.name}.csv"
    if table.exists():
        write_atomically(out / SCENES / f"{new.name}.csv", table.read_bytes())


def _do(job: Job, limits: Limits, stop: threading.Event, heard: Heard) -> list[Job]:
    """Run a job, and write failed rows for what went wrong; returns what is left to be tried in another process."""
    names = {target.key.name: target.key for target in job.targets}

    def hear(event: str) -> None:
        if event in names:
            heard(load_row(row_path(job.out, names[event])))

    outcome = run_isolated(job, limits, job.out / LOGS / f"{job.targets[0].key.name}.log", stop, hear)
    left = [target for target in job.targets if target.key.name not in outcome.events]
    if not left or stop.is_set():
        return []
    spec = None if job.predictions else find_model(job.model)
    # What goes wrong in fitting goes wrong for all tracks, what goes wrong in segmenting for this one.
    failed = left[:1] if "fitted" in outcome.events else left
    for target in failed:
        heard(_save_failure(job, target, spec, outcome.reason))
    rest = tuple(left[len(failed) :])
    return [dataclasses.replace(job, targets=rest)] if rest else []


def _save_failure(job: Job, target: Target, spec: ModelSpec | None, reason: str) -> RunRow:
    """Write a failed row for each of a target's; returns its own."""
    rows = [blank_row(key, spec, status="failed", reason=reason) for key in target.keys]
    rows = [dataclasses.replace(row, pretrained=job.pretrained) for row in rows]
    for row in rows[::-1]:
        save_row(job.out, row)
    return rows[0]
