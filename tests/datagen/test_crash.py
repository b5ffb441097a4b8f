"""Whatever ends a run, running it again completes the dataset as if nothing had happened."""

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from datagen.errors import EXIT_INCOMPLETE, EXIT_INTERRUPTED, EXIT_OK
from tests.processes import command_line, descendants, errors_at_end, wait_until, wait_until_gone
from tests.worlds.generated import FLAGS, ROOT, hashes, make

SIZES = {"train": 4, "val": 2, "test": 2}
SPLIT = "train=4,val=2,test=2"
LONG = ("--split", "train=4,val=40,test=2")
"""Scenes of a run that lasts until a signal comes that is sent once the first shard is there."""
MOST_RUNS = 100
"""Within which chance must have killed ten."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    make(folder, SIZES)
    return hashes(folder)


def start(folder: Path, *flags: object, limit: int | None = None) -> subprocess.Popen[str]:
    """The command in a process group of its own, as a terminal would start it; no file may grow beyond `limit`."""
    program = (
        "import resource, sys; from datagen.commands.entry import main\n"
        "print('begun', flush=True)\n"
        f"limit = {limit}\n"
        "if limit: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))\n"
        "sys.exit(main())"
    )
    arguments = (*FLAGS, "--split", SPLIT, "--out", folder, *flags)
    return subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "300"},
    )


def finish(folder: Path, *flags: object) -> None:
    process = start(folder, *flags)
    errors = errors_at_end(process)
    assert process.returncode == EXIT_OK, errors


def wait_for(folder: Path, pattern: str) -> None:
    wait_until(lambda: list(folder.glob(pattern)), what=pattern)


def assert_begins_with(folder: Path, whole: dict[str, list[str]]) -> None:
    """A scene does not depend on how many there are."""
    assert {split: found[: len(whole[split])] for split, found in hashes(folder).items()} == whole


def test_a_killed_run_is_completed_and_its_workers_do_not_outlive_it(tmp_path, whole):
    process = start(tmp_path, "--workers", 2, *LONG)
    wait_for(tmp_path, "train-*.h5")
    workers = {child: command_line(child) for child in descendants(process.pid)}
    assert len(workers) >= 2
    process.kill()
    errors_at_end(process)
    wait_until_gone(workers)
    finish(tmp_path, "--workers", 1, *LONG)
    assert_begins_with(tmp_path, whole)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.1, 0.3, 0.6, 1.2, 2.5])
def test_an_interrupt_while_it_begins_is_one_line(tmp_path, seconds: float):
    process = start(tmp_path, "--workers", 2, "--split", "train=400")
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)
    errors = errors_at_end(process)
    assert process.returncode == EXIT_INTERRUPTED, errors
    assert "Interrupted" in errors.splitlines()[-1]
    assert not {"Traceback", "Warning", "KeyboardInterrupt"} & set(re.findall(r"\w+", errors))


@pytest.mark.slow
def test_an_interrupted_run_says_so_in_one_line_and_can_be_completed(tmp_path, whole):
    process = start(tmp_path, "--workers", 2, *LONG)
    wait_for(tmp_path, "train-*.h5")
    os.killpg(process.pid, signal.SIGINT)
    errors = errors_at_end(process)
    assert process.returncode == EXIT_INTERRUPTED
    assert "Interrupted" in errors.splitlines()[-1]
    assert "Traceback" not in errors
    assert not list(tmp_path.glob("*.partial*"))
    finish(tmp_path, "--workers", 1, *LONG)
    assert_begins_with(tmp_path, whole)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_full_disk_is_one_line_and_leaves_finished_shards_intact(tmp_path, whole, workers: int):
    process = start(tmp_path, "--workers", workers, "--split", "train=1,val=4", limit=60_000)
    errors = errors_at_end(process)
    assert process.returncode == EXIT_INCOMPLETE
    assert "Cannot write" in errors.splitlines()[-1]
    assert not {"Traceback", "Warning"} & set(re.findall(r"\w+", errors))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dataset.json", "train-00000.h5", "train-00000.json"]
    finish(tmp_path, "--workers", 1)
    assert hashes(tmp_path)["train"] == whole["train"]


@pytest.mark.slow
def test_a_worker_that_is_killed_is_one_line_and_the_run_can_be_completed(tmp_path, whole):
    process = start(tmp_path, "--workers", 2, *LONG)
    wait_for(tmp_path, "train-*.h5")
    worker = next(child for child in descendants(process.pid) if b"datagen.pipeline.worker" in command_line(child))
    os.kill(worker, signal.SIGKILL)
    errors = errors_at_end(process)
    assert process.returncode == EXIT_INCOMPLETE
    assert "worker process died" in errors.splitlines()[-1]
    finish(tmp_path, "--workers", 1, *LONG)
    assert_begins_with(tmp_path, whole)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_ten_random_kills_lose_and_double_no_scene(tmp_path, whole):
    chance = random.Random(0)
    unbroken = time.monotonic()
    finish(tmp_path / "timed", "--workers", 2)
    unbroken = time.monotonic() - unbroken
    folder, kills = tmp_path / "killed", 0
    for _ in range(MOST_RUNS):
        if len(list(folder.glob("*.h5"))) == 3:
            shutil.rmtree(folder)
        before = {path.name: path.stat().st_ino for path in folder.glob("*.h5")}
        kills += is_killed(start(folder, "--workers", 2, "--overwrite"), chance.uniform(0.1, 1.0) * unbroken)
        after = {path.name: path.stat().st_ino for path in folder.glob("*.h5")}
        assert before.items() <= after.items()
        if kills == 10:
            break
    assert kills == 10
    finish(folder, "--workers", 2)
    assert hashes(folder) == whole
    assert not list(folder.glob("*.partial*"))


def is_killed(process: subprocess.Popen[str], seconds: float) -> bool:
    """Kill a process after so many seconds, unless it has come to a good end; none that it started outlives it."""
    try:
        _, errors = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        errors_at_end(process)
        return True
    assert process.returncode == EXIT_OK, errors
    return False


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_path_traced_twin_that_is_killed_is_completed(tmp_path, number: int):
    pytest.importorskip("mitsuba", reason="the mitsuba renderer needs the extra mitsuba")
    make(tmp_path / "plain", {"train": 2, "val": 40})
    folder = tmp_path / "traced"
    arguments = ("render", "--from", tmp_path / "plain", "--renderer", "mitsuba", "--samples", "4", "--workers", "1")
    command = [sys.executable, "-m", "datagen.commands.entry", *map(str, arguments), "--out", str(folder)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: list(folder.glob("train-*.h5")), seconds=200, what="the first shard")
    finished = {path: path.stat().st_ino for path in folder.glob("*.h5")}
    process.send_signal(number)
    errors = errors_at_end(process)
    assert process.returncode == (-number if number == signal.SIGKILL else EXIT_INTERRUPTED), errors
    assert "Traceback" not in errors
    assert not (folder / "val-00000.h5").exists()
    assert subprocess.run(command, cwd=ROOT, check=False).returncode == EXIT_OK
    assert finished == {path: path.stat().st_ino for path in finished}
    assert {split: len(scenes) for split, scenes in hashes(folder).items()} == {"train": 2, "val": 40, "test": 0}
    assert not list(folder.glob("*.partial*"))
