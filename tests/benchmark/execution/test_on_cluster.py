"""Jobs on a Dask worker in this process that does not share the run folder."""

import threading
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import pytest

from benchmark.execution import on_cluster
from benchmark.execution.executor import Limits, Outcome, run_jobs
from datagen.errors import UsageError
from datagen.pipeline.cluster import connected

LIMITS = Limits(60.0, 4000.0)


@dataclass(frozen=True)
class Third:
    """A job that fails twice, and succeeds once two earlier runs are counted in its state."""

    out: Path
    state: tuple[Path, ...]
    results: tuple[str, ...] = ("row",)

    def run(self, announce: Callable[[str], None]) -> None:
        path = self.state[0] / "count"
        path.parent.mkdir(exist_ok=True)
        count = int(path.read_text()) + 1 if path.exists() else 1
        path.write_text(str(count))
        if count < 3:
            raise UsageError("It failed as planned.")
        announce("row")


def test_a_job_resumes_what_a_lost_worker_or_client_left(
    local_cluster: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    job, failures = Third(tmp_path, (tmp_path / "training",)), []
    with connected(local_cluster) as cluster:  # a client that is lost before it gets the files
        cluster.call(on_cluster.run_remotely, job, LIMITS, tmp_path / "nowhere", stop=threading.Event())
    assert not job.state[0].exists()

    def on_failure(_: Third, outcome: Outcome) -> list[Third]:
        failures.append(outcome.reason)
        return [job] if len(failures) < 3 else []

    monkeypatch.setattr(on_cluster, "shared_mark", lambda folder: nullcontext(folder / "nowhere"))
    with on_cluster.on_cluster(local_cluster, tmp_path):
        run_jobs([job], lambda _: LIMITS, 1, on_event=lambda *_: None, on_failure=on_failure)
    assert failures == ["It failed as planned."]
    assert (job.state[0] / "count").read_text() == "3"


def test_changed_files_are_copied_while_a_job_runs(tmp_path: Path):
    copies, copied = [], threading.Event()

    class Kept:
        def write(self, files: dict[str, bytes]) -> None:
            copies.append(files)
            copied.set()

    with on_cluster._copying(tmp_path, [tmp_path / "training"], Kept(), every_seconds=0.01):
        (tmp_path / "training").mkdir()
        (tmp_path / "training" / ".model").write_bytes(b"weights")
        (tmp_path / "training" / ".model").rename(tmp_path / "training" / "model")
        assert copied.wait(10)
    assert copies == [{"training/model": b"weights"}]
