import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from functools import partial
from pathlib import Path

import pytest

from datagen.errors import Busy, DatagenError, UsageError
from datagen.storage.atomic import (
    cache_folder,
    check_new_folder,
    is_running,
    locked_folder,
    new_file,
    new_folder,
    remove_abandoned,
    replacing,
    target_name,
    temporary_path,
    updated_folder,
    write_atomically,
)


def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path: Path):
    path = tmp_path / "new" / "file"
    write_atomically(path, b"one")
    write_atomically(path, b"two")
    assert path.read_bytes() == b"two"
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "file"
    write_atomically(path, b"one")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(DatagenError, match="No space left on device"):
        write_atomically(path, b"two")
    assert path.read_bytes() == b"one"
    assert list(tmp_path.iterdir()) == [path]


def test_contents_are_durable_before_the_file_has_its_name_and_the_name_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path, synced = tmp_path / "file", []

    def sync(descriptor: int) -> None:
        synced.append((Path(os.readlink(f"/proc/self/fd/{descriptor}")), path.exists()))

    monkeypatch.setattr("os.fsync", sync)
    write_atomically(path, b"one")
    assert synced == [(temporary_path(path), False), (tmp_path, True)]


def test_a_file_is_no_folder(tmp_path: Path):
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(UsageError, match="notes is a file"), locked_folder(tmp_path / "notes"):
        raise AssertionError
    assert (tmp_path / "notes").read_text() == "mine"


def test_the_folder_of_a_dataset_takes_no_results(tmp_path: Path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "dataset.json").write_text("{")
    with pytest.raises(UsageError, match="set holds a dataset; give another --out"), locked_folder(tmp_path / "set"):
        raise AssertionError
    with pytest.raises(UsageError, match="set holds a dataset; give another --out"):
        check_new_folder(tmp_path / "set")
    assert [path.name for path in (tmp_path / "set").iterdir()] == ["dataset.json"]
    with locked_folder(tmp_path / "set" / "run"):
        pass


def temporary(name: str, process: int, *, host: str = socket.gethostname(), thread: int = 1) -> str:
    return f".{name}.partial-{host}-{process}-{thread}"


def ended_process() -> int:
    ended = subprocess.Popen(["true"])
    ended.wait()
    return ended.pid


def test_only_files_of_writers_that_are_gone_are_abandoned(tmp_path: Path):
    other = threading.Thread(target=(release := threading.Event()).wait, daemon=True)
    other.start()
    old = time.time() - 7200
    stay = {
        temporary("a", ended_process()): False,
        temporary("a", os.getpid()): False,
        temporary("a", os.getpid(), thread=other.native_id or 0): True,
        temporary("a", os.getppid()): True,
        temporary("a", 10**30): False,
        temporary("a", 1, host="else-where.org"): True,
        temporary("old", 1, host="else-where.org"): False,
        "a": True,
        ".thesis.partial-2": True,
    }
    for name in stay:
        (tmp_path / name).write_bytes(b"")
        if name.startswith(".old"):
            os.utime(tmp_path / name, (old, old))
    (tmp_path / "below").mkdir()
    below = tmp_path / "below" / temporary("a", ended_process())
    below.write_bytes(b"")
    remove_abandoned(tmp_path)
    assert {name: (tmp_path / name).exists() for name in stay} == stay
    assert below.exists()
    remove_abandoned(tmp_path, recursive=True)
    assert not below.exists()
    release.set()
    other.join()


def test_a_temporary_path_leads_back_to_its_target():
    for name in ("a", "a.partial-b-1-2", "train-00000.h5"):
        assert target_name(temporary_path(Path(name))) == name == target_name(Path(name))


def test_a_failed_replacement_leaves_the_previous_file(tmp_path: Path):
    path = tmp_path / "file"
    path.write_bytes(b"one")
    with suppress(ZeroDivisionError), replacing(path) as unfinished:
        unfinished.write_bytes(b"half")
        fail()
    with pytest.raises(ZeroDivisionError):
        write_atomically(path, b"two", check=fail)
    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"one", [path])


def test_a_folder_is_locked_for_one_process(tmp_path: Path):
    left = tmp_path / temporary("file", ended_process())
    left.write_bytes(b"half")
    with locked_folder(tmp_path):
        assert not left.exists()
        left.write_bytes(b"of the first")
        with pytest.raises(Busy, match="Another process is writing to"), locked_folder(tmp_path):
            raise AssertionError
        assert left.exists()
    with locked_folder(tmp_path):
        assert not list(tmp_path.iterdir())


def make(folder: Path, content: bytes, meanwhile: Callable[[], None] = lambda: None) -> None:
    with new_folder(folder) as unfinished:
        (unfinished / "file").write_bytes(content)
        meanwhile()


def fail() -> None:
    raise ZeroDivisionError


def test_a_new_folder_is_there_whole_or_not_at_all(tmp_path: Path):
    made = tmp_path / "made"
    make(made, b"one", meanwhile=lambda: assert_missing(made))
    with pytest.raises(ZeroDivisionError):
        make(tmp_path / "failed", b"half", meanwhile=fail)
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_what_killed_processes_left_of_new_ones_goes_when_it_is_made_again(tmp_path: Path):
    for process in (ended_process(), os.getppid()):
        for name in ("made", "a[1].png", "other"):
            (tmp_path / temporary(name, process)).mkdir()
            (tmp_path / temporary(name, process) / "file").write_bytes(b"half")
    make(tmp_path / "made", b"whole")
    write(tmp_path / "a[1].png", b"whole")
    running = {temporary(name, os.getppid()) for name in ("made", "a[1].png", "other")}
    left = {path.name for path in tmp_path.iterdir()} - {path.name for path in tmp_path.glob(".other*")}
    assert left == (running | {"made", "a[1].png"}) - {temporary("other", os.getppid())}
    assert len(list(tmp_path.glob(".other*"))) == 2


def assert_missing(path: Path) -> None:
    assert not path.exists()


def test_of_two_that_make_the_same_folder_the_second_is_told(tmp_path: Path):
    made = tmp_path / "made"

    def be_faster() -> None:
        thread = threading.Thread(target=make, args=(made, b"first"))
        thread.start()
        thread.join()

    with pytest.raises(UsageError, match="made already exists and is not empty; give another --out"):
        make(made, b"second", meanwhile=be_faster)
    assert [path.name for path in tmp_path.iterdir()] == ["made"]
    assert (made / "file").read_bytes() == b"first"


def test_the_current_folder_is_no_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="is the current folder; give a new one"), new_folder(Path()):
        raise AssertionError


def write(path: Path, content: bytes, meanwhile: Callable[[], None] = lambda: None) -> None:
    with new_file(path) as unfinished:
        assert unfinished.name == path.name
        unfinished.write_bytes(content)
        meanwhile()


def test_a_new_file_takes_no_other_one_s_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.png"
    with pytest.raises(UsageError, match=r"a\.png already exists; give another --out"):
        write(path, b"second", meanwhile=lambda: path.write_bytes(b"first") and None)
    assert path.read_bytes() == b"first"
    with pytest.raises(ZeroDivisionError):
        write(tmp_path / "b.png", b"half", meanwhile=fail)

    def unknown(_one: Path, _other: Path) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", unknown)
    write(tmp_path / "c.png", b"whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "c.png"]


@pytest.mark.parametrize("make", [new_file, new_folder, partial(new_folder, replace=True)])
def test_links_that_lead_to_themselves_are_told(tmp_path: Path, make: Callable[[Path], AbstractContextManager[Path]]):
    for one, other in (("circle", "other"), ("other", "circle")):
        (tmp_path / one).symlink_to(tmp_path / other)
    with (
        pytest.raises(UsageError, match=r"circle (is|already exists) .*; give"),
        make(tmp_path / "circle"),
    ):
        pass


def test_a_link_that_leads_nowhere_is_told(tmp_path: Path):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(UsageError, match="link already exists as a link that leads nowhere"):
        write(tmp_path / "link", b"picture")
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_where_a_file_cannot_be_its_own_name_is_told_before_anything_is_made(tmp_path: Path):
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file" / "a.png", Path("/proc/none/a.png")):
        with pytest.raises(DatagenError, match=f"Cannot write {path}: .*; fix this, or give another --out"):
            write(path, b"picture", meanwhile=fail)


def test_a_full_disk_is_told_with_the_name_that_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    for make, path in ((new_file, tmp_path / "a.png"), (new_folder, tmp_path / "folder")):
        with pytest.raises(DatagenError, match=f"Cannot write {path}: No space left"), make(path) as unfinished:
            write_atomically(unfinished if make is new_file else unfinished / "a.png", b"picture")
    assert not list(tmp_path.iterdir())


def test_running_processes_are_told_from_ended_ones(monkeypatch: pytest.MonkeyPatch):
    assert is_running(os.getpid())
    assert not is_running(ended_process())
    assert not is_running(10**30)

    def refuse(process: int, signal: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "kill", refuse)
    assert is_running(1)


def test_a_killed_process_does_not_run_although_its_parent_has_not_waited_for_it(tmp_path: Path):
    (tmp_path / "a) R").symlink_to(shutil.which("cat") or "")
    with subprocess.Popen([tmp_path / "a) R"], stdin=subprocess.PIPE) as process:
        assert is_running(process.pid)
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert not is_running(process.pid)


def test_a_folder_is_replaced_only_once_the_new_one_is_complete(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old").touch()
    with pytest.raises(KeyError), new_folder(tmp_path / "out", replace=True):
        raise KeyError
    assert os.listdir(tmp_path / "out") == ["old"]
    with new_folder(tmp_path / "out", replace=True) as temporary:
        (temporary / "new").touch()
        assert os.listdir(tmp_path / "out") == ["old"]
    assert os.listdir(tmp_path / "out") == ["new"]
    assert os.listdir(tmp_path) == ["out"]


def test_an_updated_folder_keeps_its_files_unless_all_new_ones_are_complete(tmp_path: Path):
    def update(content: str, meanwhile: Callable[[], None] = lambda: None) -> None:
        with updated_folder(tmp_path / "out", ("first", "second")) as temporary:
            (temporary / "second").write_text(content)
            meanwhile()

    update("old")
    update("new")
    with pytest.raises(ZeroDivisionError):
        update("half", fail)
    assert (tmp_path / "out" / "second").read_text() == "new"
    assert os.listdir(tmp_path / "out") == ["second"]
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({}, "/home/me/.cache/obpose"),
        ({"XDG_CACHE_HOME": "/scratch"}, "/scratch/obpose"),
        ({"XDG_CACHE_HOME": "scratch"}, "/home/me/.cache/obpose"),
        ({"XDG_CACHE_HOME": ""}, "/home/me/.cache/obpose"),
        ({"XDG_CACHE_HOME": "/scratch", "OBPOSE_CACHE": "~/mine"}, "/home/me/mine"),
    ],
)
def test_variables_name_the_cache(variables: dict[str, str], folder: str, monkeypatch: pytest.MonkeyPatch):
    for name in ("XDG_CACHE_HOME", "OBPOSE_CACHE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": "/home/me", **variables}.items():
        monkeypatch.setenv(name, value)
    assert cache_folder() == Path(folder)
