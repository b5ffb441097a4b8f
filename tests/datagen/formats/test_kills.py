"""Imports, exports and dry runs that end at any of their changes of the disk are repeated as if they had not begun."""

import os
import shutil
import signal
import sys
import warnings
from pathlib import Path
from typing import Any

import pytest

from datagen.commands.cli import main
from datagen.errors import EXIT_INTERRUPTED, EXIT_OK
from datagen.formats.export import export
from datagen.storage.spec import MANIFEST_FILE

CHANGES = ("os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.link", "shutil.rmtree")
"""Audit events of calls that change the disk; the event `open` does so too if the mode is one for writing."""


def run(arguments: list[str], folder: Path, *, last: int = 10**9, number: int = signal.SIGKILL) -> tuple[int, int]:
    """Run a command in a fork that gets a signal before its change number `last` in a folder.

    Returns:
        The exit code, negative after a signal, and the number of changes.
    """
    read, write = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks beside threads
        process = os.fork()
    if process == 0:
        changes = 0

        def watch(event: str, values: tuple[Any, ...]) -> None:
            nonlocal changes
            writes = event == "open" and isinstance(values[2], int) and values[2] & (os.O_WRONLY | os.O_RDWR)
            if (writes or event in CHANGES) and str(values[0]).startswith(str(folder)):
                changes += 1
                os.write(write, b".")
                if changes == last:
                    os.kill(os.getpid(), number)

        code = 99
        try:
            sys.addaudithook(watch)
            code = main(arguments)
        finally:
            os._exit(code)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        changes = len(pipe.read())
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), changes


def tree(folder: Path) -> dict[str, bytes]:
    """The files of a folder, but for the one that says how long they took."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST_FILE)
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def positions(changes: int) -> list[int]:
    """The first, the last, and some changes in between; many of the last rename and delete folders."""
    return sorted({1, *range(3, changes, changes // 4 + 1), *range(max(1, changes - 5), changes + 1)})


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
@pytest.mark.parametrize("kind", ["import", "webdataset", "bop"])
def test_a_new_folder_is_whole_or_missing_and_can_be_made_again(
    clips: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], kind: str, number: int
):
    work = tmp_path / "work"
    arguments = ["export", "--format", kind, str(clips), "--out", str(work / "out")]
    if kind == "import":
        export(clips, tmp_path / "source", "rgbd")
        arguments = ["import", "--format", "rgbd", str(tmp_path / "source"), "--out", str(work / "out")]
    code, changes = run(arguments, work)
    assert code == EXIT_OK
    whole = tree(work / "out")
    for last in positions(changes):
        shutil.rmtree(work)
        code, _ = run(arguments, work, last=last, number=number)
        assert code == (-number if number == signal.SIGKILL else EXIT_INTERRUPTED)
        assert tree(work / "out") in ({}, whole)
        if number == signal.SIGINT:
            assert "Traceback" not in capfd.readouterr().err
            assert not list(work.glob(".*"))
        if not (work / "out").exists():
            assert main(arguments) == EXIT_OK
            assert tree(work / "out") == whole
            assert os.listdir(work) == ["out"]


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_an_export_that_is_replaced_is_the_old_or_the_new_one(
    clips: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], number: int
):
    work = tmp_path / "work"
    arguments = ["export", "--format", "coco", str(clips), "--out", str(work / "out"), "--overwrite"]
    export(clips, tmp_path / "old", "rgbd")
    export(clips, tmp_path / "new", "coco")
    old, new = tree(tmp_path / "old"), tree(tmp_path / "new")
    shutil.copytree(tmp_path / "old", work / "out")
    _, changes = run(arguments, work)
    assert tree(work / "out") == new
    for last in positions(changes):
        shutil.rmtree(work)
        shutil.copytree(tmp_path / "old", work / "out")
        code, _ = run(arguments, work, last=last, number=number)
        assert code == (-number if number == signal.SIGKILL else EXIT_INTERRUPTED)
        if number == signal.SIGINT:
            message = "complete" if tree(work / "out") == new else "nothing was exported"
            assert message in capfd.readouterr().err
            assert tree(work / "out") in (old, new)
        assert tree(work / "out") in (old, new) or [tree(path) for path in work.glob(".out.old.*")] == [old]
        assert main(arguments) == EXIT_OK
        assert tree(work / "out") == new
        assert os.listdir(work) == ["out"]


def test_a_dry_run_changes_nothing(clips: Path, tmp_path: Path):
    export(clips, tmp_path / "out", "webdataset")
    assert run(["push", str(tmp_path / "out"), "ada/moving", "--dry-run"], tmp_path) == (EXIT_OK, 0)
