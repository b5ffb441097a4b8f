"""Locks on folders, and commands that run in one folder at the same time."""

import os
import shutil
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from datagen.errors import EXIT_OK, EXIT_USAGE
from datagen.storage.locks import FolderLock
from datagen.storage.manifest import read_manifest
from datagen.storage.reader import Dataset
from tests.processes import errors_at_end, wait_until
from tests.worlds.generated import FLAGS, ROOT, command, hashes, make

SMALL = (*FLAGS, "--workers", "1")


def start(folder: Path, *flags: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "datagen.commands.entry", *map(str, (*SMALL, "--out", folder, *flags))],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "300"},
    )


def wait_for(path: Path) -> None:
    wait_until(path.exists, what=path.name)


def test_one_has_a_folder_alone_or_many_share_it(tmp_path):
    with (
        closing(FolderLock(tmp_path)) as first,
        closing(FolderLock(tmp_path)) as second,
        closing(FolderLock(tmp_path)) as third,
    ):
        assert first.take_alone()
        assert not second.take_alone()
        assert not second.take_shared()
        assert first.take_shared()
        assert second.take_shared()
        assert not third.take_alone()
        assert first.is_real
        assert not third.is_real
    with closing(FolderLock(tmp_path)) as lock:
        assert lock.take_alone()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_was_removed_or_replaced_is_known(tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    with closing(FolderLock(folder)) as lock:
        assert lock.is_current()
        folder.rename(tmp_path / "moved")
        assert not lock.is_current()
        folder.mkdir()
        assert not lock.is_current()
    with pytest.raises(NotADirectoryError), closing(FolderLock(Path(__file__))):
        raise AssertionError


def test_file_systems_without_locks_grant_everything(tmp_path, monkeypatch):
    def unsupported(_descriptor: int, _kind: int) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", unsupported)
    with closing(FolderLock(tmp_path)) as first, closing(FolderLock(tmp_path)) as second:
        assert first.take_alone()
        assert second.take_alone()
        assert not second.is_real


def test_a_run_keeps_others_out_until_it_is_killed(tmp_path):
    folder = tmp_path / "set"
    process = start(folder, "--seed", 9, "--split", "train=1000")
    wait_for(folder / "dataset.json")
    for flags in (("--overwrite",), ()):
        other = command(*SMALL, "--seed", 1, "--split", "train=1", "--out", folder, *flags, cwd=tmp_path)
        assert other.returncode == EXIT_USAGE
        assert f"Another obpose-datagen is writing to {folder} with other settings (seed: 9 -> 1)" in other.stderr
    assert process.poll() is None
    process.kill()
    errors_at_end(process)
    assert Dataset(folder).spec["seed"] == 9
    other = command(*SMALL, "--seed", 1, "--split", "train=1", "--out", folder, "--overwrite", cwd=tmp_path)
    assert other.returncode == EXIT_OK, other.stderr
    assert Dataset(folder).spec["seed"] == 1
    hashes(folder)


@pytest.mark.slow
def test_of_two_datasets_that_are_begun_in_one_folder_one_is_made(tmp_path):
    for flags in ((), ("--overwrite",), ()):
        shutil.rmtree(tmp_path / "set", ignore_errors=True)
        seeds = (1, 2)
        runs = [start(tmp_path / "set", "--seed", seed, "--split", "train=90", *flags) for seed in seeds]
        errors = [errors_at_end(process) for process in runs]
        assert sorted(process.returncode for process in runs) == [EXIT_OK, EXIT_USAGE], errors
        winner = seeds[[process.returncode for process in runs].index(EXIT_OK)]
        dataset = Dataset(tmp_path / "set")
        dataset.check_complete()
        assert (dataset.spec["seed"], dataset.splits["train"]) == (winner, 90)
        hashes(tmp_path / "set")


@pytest.mark.slow
def test_jobs_of_an_array_make_one_dataset_side_by_side(tmp_path):
    sizes = {"train": 2, "val": 2, "test": 2}
    split = ",".join(f"{name}={number}" for name, number in sizes.items())
    jobs = [start(tmp_path / "set", "--split", split, "--shard", f"{i}/3") for i in range(3)]
    errors = [errors_at_end(job) for job in jobs]
    assert [job.returncode for job in jobs] == [EXIT_OK] * 3, errors
    make(tmp_path / "alone", sizes)
    assert hashes(tmp_path / "set") == hashes(tmp_path / "alone")
    assert read_manifest(tmp_path / "set")["splits"] == read_manifest(tmp_path / "alone")["splits"]
