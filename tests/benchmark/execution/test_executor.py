import os
import sys
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from benchmark.execution.executor import LOGS, Limits, Outcome, limits, run_jobs
from datagen.errors import Busy, UsageError
from tests.processes import in_this_process


@dataclass(frozen=True)
class Steps:
    """A job that announces its results in order, except for those with the names of failures."""

    out: Path
    results: tuple[str, ...]
    state: tuple[Path, ...] = ()

    def run(self, announce: Callable[[str], None]) -> None:
        for name in self.results:
            if name == "fail":
                raise UsageError("It failed as planned.")
            if name == "busy":
                raise Busy("Another process does this.")
            if name == "sleep":
                time.sleep(60)
            if name == "crash":
                print("about to crash", file=sys.stderr, flush=True)
                os.abort()
            if name == "orphan":
                if not os.fork():
                    time.sleep(60)
                os.abort()
            announce(name)


def run(*jobs: Steps, workers: int = 1, seconds: float = 60.0) -> tuple[list[str], list[Outcome]]:
    """Events and failures; what is left after a failed result is tried again."""
    events: list[str] = []
    failures: list[Outcome] = []

    def on_failure(job: Steps, outcome: Outcome) -> list[Steps]:
        failures.append(outcome)
        left = [name for name in job.results if name not in outcome.events][1:]
        return [replace(job, results=tuple(left))] if left else []

    share = Limits(seconds, 4000.0)
    run_jobs(jobs, lambda _: share, workers, on_event=lambda _, event: events.append(event), on_failure=on_failure)
    return events, failures


@pytest.mark.parametrize("place", [in_this_process, nullcontext])
def test_a_failure_costs_one_result_and_the_rest_is_tried_next(tmp_path: Path, place: Callable[[], object]):
    with place():  # type: ignore[attr-defined]
        events, failures = run(Steps(tmp_path, ("a", "fail", "b")), Steps(tmp_path, ("c",)))
    assert events == ["a", "b", "c"]
    assert failures == [Outcome(("a",), "It failed as planned.")]


@pytest.mark.parametrize("place", [in_this_process, nullcontext])
def test_work_of_another_process_stops_everything(tmp_path: Path, place: Callable[[], object]):
    with place(), pytest.raises(Busy):  # type: ignore[attr-defined]
        run(Steps(tmp_path, ("busy",)), Steps(tmp_path, ("a",)))


def test_a_crash_leaves_a_log_and_a_success_does_not(tmp_path: Path):
    _, failures = run(Steps(tmp_path, ("crash",)), Steps(tmp_path, ("a",)))
    assert [outcome.reason for outcome in failures] == ["crashed with SIGABRT"]
    assert [path.name for path in (tmp_path / LOGS).iterdir()] == ["crash.log"]


def test_a_crash_is_noticed_though_a_child_lives_on(tmp_path: Path):
    _, failures = run(Steps(tmp_path, ("orphan",)), seconds=20.0)
    assert [outcome.reason for outcome in failures] == ["crashed with SIGABRT"]


def test_the_time_limit_holds_for_each_result(tmp_path: Path):
    events, failures = run(Steps(tmp_path, ("sleep", "a")), seconds=4.0)
    assert events == ["a"]
    assert [outcome.reason[:31] for outcome in failures] == ["took longer than the time limit"]


def test_limits_are_equal_parts_of_the_machine_unless_given():
    assert limits(5.0, workers=2).memory_mib == pytest.approx(limits(5.0, workers=1).memory_mib / 2)
    assert limits(5.0, workers=2, memory_mib=100.0, threads=3) == Limits(5.0, 100.0, 3)
