import os
import subprocess
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from obpose.errors import Busy, DatagenError, UsageError
from obpose.storage.files import check_free, claimed, new_file, new_folder, remove_abandoned, write_whole


def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path: Path):
    path = tmp_path / "new" / "file"
    write_whole(path, b"one")
    write_whole(path, b"two")
    assert path.read_bytes() == b"two"
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_what_was_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "file"
    write_whole(path, b"one")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(DatagenError, match="No space left on device"):
        write_whole(path, b"two")
    assert path.read_bytes() == b"one"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_no_folder(tmp_path: Path):
    (tmp_path / "notes").write_text("mine")
    with pytest.raises(UsageError, match="notes is a file"), claimed(tmp_path / "notes"):
        raise AssertionError
    assert (tmp_path / "notes").read_text() == "mine"


def test_the_folder_of_a_dataset_takes_no_results(tmp_path: Path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "dataset.json").write_text("{")
    with pytest.raises(UsageError, match="set holds a dataset; give another --out"), claimed(tmp_path / "set"):
        raise AssertionError
    with pytest.raises(UsageError, match="set holds a dataset; give another --out"):
        check_free(tmp_path / "set")
    assert [path.name for path in (tmp_path / "set").iterdir()] == ["dataset.json"]
    with claimed(tmp_path / "set" / "run"):
        pass


def test_what_killed_processes_left_is_removed(tmp_path: Path):
    (tmp_path / ".file.123.partial").write_bytes(b"half")
    (tmp_path / "file").write_bytes(b"whole")
    (tmp_path / ".thesis.partial").write_bytes(b"somebody else's")
    remove_abandoned(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"file", ".thesis.partial"}


def test_a_folder_is_one_process_s_until_it_lets_go(tmp_path: Path):
    (tmp_path / ".file.123.partial").write_bytes(b"half")
    with claimed(tmp_path):
        (tmp_path / ".file.124.partial").write_bytes(b"of the first")
        with pytest.raises(Busy, match="Another process is writing to"), claimed(tmp_path):
            raise AssertionError
        assert [path.name for path in tmp_path.iterdir()] == [".file.124.partial"]
    with claimed(tmp_path):
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
    ended = subprocess.Popen(["true"])
    ended.wait()
    for process in (ended.pid, os.getppid(), 10**12):
        (tmp_path / f".made.{process}-1.unfinished").mkdir()
        (tmp_path / f".made.{process}-1.unfinished" / "file").write_bytes(b"half")
        (tmp_path / f".a[1].{process}-1.unfinished.png").write_bytes(b"half")
    make(tmp_path / "made", b"whole")
    write(tmp_path / "a[1].png", b"whole")
    others = [f".made.{os.getppid()}-1.unfinished", f".a[1].{os.getppid()}-1.unfinished.png"]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*others, "made", "a[1].png"])


def assert_missing(path: Path) -> None:
    assert not path.exists()


def test_of_two_that_make_the_same_folder_the_second_is_told(tmp_path: Path):
    made = tmp_path / "made"

    def be_faster() -> None:
        thread = threading.Thread(target=make, args=(made, b"first"))
        thread.start()
        thread.join()

    with pytest.raises(UsageError, match="made is there already and not empty; give another --out"):
        make(made, b"second", meanwhile=be_faster)
    assert [path.name for path in tmp_path.iterdir()] == ["made"]
    assert (made / "file").read_bytes() == b"first"


def test_the_current_folder_is_no_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="is the current folder; give a new one"), new_folder(Path()):
        raise AssertionError


def write(path: Path, content: bytes, meanwhile: Callable[[], None] = lambda: None) -> None:
    with new_file(path) as unfinished:
        assert unfinished.suffix == path.suffix
        unfinished.write_bytes(content)
        meanwhile()


def test_a_new_file_takes_no_other_one_s_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.png"
    with pytest.raises(UsageError, match=r"a\.png is there already; give another --out"):
        write(path, b"second", meanwhile=lambda: path.write_bytes(b"first") and None)
    assert path.read_bytes() == b"first"
    with pytest.raises(ZeroDivisionError):
        write(tmp_path / "b.png", b"half", meanwhile=fail)

    def unknown(_one: Path, _other: Path) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", unknown)
    write(tmp_path / "c.png", b"whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "c.png"]


@pytest.mark.parametrize("make", [new_file, new_folder])
def test_links_that_lead_to_themselves_are_told(tmp_path: Path, make: Callable[[Path], AbstractContextManager[Path]]):
    for one, other in (("circle", "other"), ("other", "circle")):
        (tmp_path / one).symlink_to(tmp_path / other)
    with pytest.raises(UsageError, match=r"circle is .*; give another --out"), make(tmp_path / "circle"):
        pass


def test_a_link_that_leads_nowhere_is_told(tmp_path: Path):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(UsageError, match="link is there already as a link that leads nowhere"):
        write(tmp_path / "link", b"picture")
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_where_a_file_cannot_be_its_own_name_is_told_before_anything_is_made(tmp_path: Path):
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file" / "a.png", Path("/proc/none/a.png")):
        with pytest.raises(DatagenError, match=f"Cannot write {path}: .*; mend this, or give another --out"):
            write(path, b"picture", meanwhile=fail)


def test_a_full_disk_is_told_with_the_name_that_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    for make, path in ((new_file, tmp_path / "a.png"), (new_folder, tmp_path / "folder")):
        with pytest.raises(DatagenError, match=f"Cannot write {path}: No space left"), make(path) as unfinished:
            write_whole(unfinished if make is new_file else unfinished / "a.png", b"picture")
    assert not list(tmp_path.iterdir())
