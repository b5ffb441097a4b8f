from pathlib import Path

import pytest

from obpose.errors import DatagenError
from obpose.files import remove_abandoned, write_whole


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


def test_what_killed_processes_left_is_removed(tmp_path: Path):
    (tmp_path / ".file.123.partial").write_bytes(b"half")
    (tmp_path / "file").write_bytes(b"whole")
    remove_abandoned(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
