import csv
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmark.results import load_runs
from tests import foreign
from tests.fabricated import write_dataset

ROOT = Path(__file__).parent.parent.parent
MODELS = ("slow", "chance", "good", "raises", "plane-dbscan")
TABLES = ("leaderboard.csv", "per_seed.csv", "per_scene.csv")

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("resume")
    write_dataset(folder / "data", scenes=3, frames=2)
    foreign.install(folder / "site")
    return folder


def start(place: Path, out: Path, *flags: object, models: tuple[str, ...] = MODELS) -> subprocess.Popen[str]:
    command = ["--model", *models, "--data", place / "data", "--out", out, "--seeds", 2]
    command += ["--deterministic", "--steps", 3, *flags]
    return subprocess.Popen(
        [sys.executable, "-m", "benchmark.cli", *map(str, command)],
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{place / 'site'}", "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
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
    _, errors = process.communicate()
    assert process.returncode == 3, errors
    return contents(place / "whole"), time.monotonic() - started


def test_a_run_that_is_killed_at_any_moment_and_resumed_gives_the_same_tables(place: Path, whole, tmp_path: Path):
    expected, seconds = whole
    chance = random.Random(0)
    for _ in range(6):
        process = start(place, tmp_path)
        try:
            process.communicate(timeout=chance.uniform(0.1, 0.6) * seconds)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.communicate()
        load_runs(tmp_path)
    process = start(place, tmp_path)
    process.communicate()
    assert contents(tmp_path) == expected
    assert not list(tmp_path.rglob("*.partial"))


def test_the_number_of_workers_changes_nothing(place: Path, whole, tmp_path: Path):
    start(place, tmp_path, "--workers", 1).communicate()
    assert contents(tmp_path) == whole[0]


def test_workers_do_not_outlive_a_killed_run(place: Path, tmp_path: Path):
    process = start(place, tmp_path, models=("hangs",))
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("labels/.*.partial")):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    workers = children(process.pid)
    assert workers
    process.kill()
    process.communicate()
    while any(command_line(worker) for worker in workers):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_ctrl_c_is_one_line_and_leaves_no_half_row(place: Path, tmp_path: Path):
    process = start(place, tmp_path)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("runs/*.json")):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert process.returncode == 130
    assert (
        errors.splitlines()[-1] == "obpose-bench: Interrupted; finished rows are kept, the same command again goes on."
    )
    assert "Traceback" not in errors
    assert not any("interrupted" in row.reason for row in load_runs(tmp_path))


def children(process: int) -> list[int]:
    tasks = Path(f"/proc/{process}/task").glob("*/children")
    found = [int(child) for task in tasks for child in task.read_text().split()]
    return [child for child in found if b"benchmark.worker" in command_line(child)]


def command_line(process: int) -> bytes:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""
