import csv
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmark.results.run_folder import load_runs
from tests import fake_plugins
from tests.paths import ROOT
from tests.processes import command_line, descendants, errors_at_end, wait_until, wait_until_gone
from tests.worlds.traced import write_dataset

MODELS = ("slow", "chance", "good", "raises", "plane-dbscan")
TABLES = ("leaderboard.csv", "per_seed.csv", "per_scene.csv")

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("resume")
    write_dataset(folder / "data", scenes=3, frames=2)
    fake_plugins.install(folder / "site")
    return folder


def start(place: Path, out: Path, *flags: object, models: tuple[str, ...] = MODELS) -> subprocess.Popen[str]:
    command = ["--model", *models, "--data", place / "data", "--out", out, "--seeds", 2]
    command += ["--deterministic", "--steps", 3, *flags]
    return subprocess.Popen(
        [sys.executable, "-m", "benchmark.commands.cli", *map(str, command)],
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{place / 'site'}", "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def without_measured(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return [{n: v for n, v in row.items() if not n.startswith("measured_")} for row in csv.DictReader(file)]


def contents(out: Path) -> dict[str, object]:
    scenes = {path.name: path.read_bytes() for path in (out / "scenes").iterdir()}
    return scenes | {name: without_measured(out / name) for name in TABLES}


@pytest.fixture(scope="module")
def whole(place: Path) -> tuple[dict[str, object], float]:
    started = time.monotonic()
    process = start(place, place / "whole")
    errors = errors_at_end(process)
    assert process.returncode == 3, errors
    return contents(place / "whole"), time.monotonic() - started


def test_a_run_that_is_killed_at_any_moment_and_resumed_gives_the_same_tables(place: Path, whole, tmp_path: Path):
    expected, seconds = whole
    chance = random.Random(0)
    for _ in range(4):
        process = start(place, tmp_path)
        try:
            process.communicate(timeout=chance.uniform(0.1, 0.6) * seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            errors_at_end(process)
        load_runs(tmp_path)
    process = start(place, tmp_path)
    errors_at_end(process)
    assert contents(tmp_path) == expected
    assert not list(tmp_path.rglob("*.partial*"))


def test_the_number_of_workers_changes_nothing(place: Path, whole, tmp_path: Path):
    errors_at_end(start(place, tmp_path, "--workers", 1))
    assert contents(tmp_path) == whole[0]


def test_workers_and_what_models_start_do_not_outlive_a_killed_run(place: Path, tmp_path: Path):
    process = start(place, tmp_path, models=("hangs",))
    wait_until(lambda: any(b"sleep" in line for line in lines_of(process.pid).values()), what="the model's own process")
    workers = lines_of(process.pid)
    assert any(b"benchmark.execution.worker" in line for line in workers.values())
    process.kill()
    errors_at_end(process)
    wait_until_gone(workers)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_is_one_line_and_leaves_no_half_row(place: Path, tmp_path: Path, number: signal.Signals):
    process = start(place, tmp_path)
    wait_until(lambda: list(tmp_path.glob("runs/*.json")), what="the first row")
    process.send_signal(number)
    errors = errors_at_end(process)
    assert process.returncode == 130
    assert (
        errors.splitlines()[-1]
        == "obpose-bench: Interrupted; finished rows are kept. Run the same command again to resume."
    )
    assert "Traceback" not in errors
    assert not any("interrupted" in row.reason for row in load_runs(tmp_path))


def lines_of(process: int) -> dict[int, bytes]:
    return {child: command_line(child) for child in descendants(process)}
