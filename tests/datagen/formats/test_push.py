import sys
from pathlib import Path
from typing import Any

import pytest

from datagen.commands.cli import main
from datagen.errors import DatagenError, UsageError
from datagen.formats.export import export
from datagen.formats.push import plan_upload, push
from datagen.inspect.dataset_card import write_card


class Hub:
    """Stands in for the hub's client."""

    def __init__(self, error: Exception | None = None):
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self._error = error

    def create_repo(self, **settings: Any) -> None:
        self.calls.append(("create_repo", settings))

    def upload_folder(self, **settings: Any) -> None:
        self.calls.append(("upload_folder", settings))
        if self._error:
            raise self._error


@pytest.fixture
def folder(clips: Path, tmp_path: Path) -> Path:
    export(clips, tmp_path / "out", "webdataset")
    return tmp_path / "out"


def test_a_dry_run_lists_the_files_and_needs_no_client(folder: Path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    (folder / ".train-000001.tar.partial-host-1-1").write_bytes(b"unfinished")
    assert main(["push", str(folder), "ada/moving", "--dry-run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:-1] == ["  README.md", "  croissant.json", "  export.json", "  train-000000.tar"]
    assert lines[-1].startswith("4 files, ")
    assert lines[-1].endswith("would go to https://huggingface.co/datasets/ada/moving (private if new).")


def test_a_dataset_can_be_pushed_as_it_is(clips: Path):
    write_card(clips)
    files = plan_upload(clips, "ada/moving").files
    assert {"README.md", "croissant.json", "dataset.json", "train-00000.h5"} <= set(files)


def test_the_hub_gets_one_commit(folder: Path):
    hub = Hub()
    push(folder, plan_upload(folder, "ada/moving"), private=True, hub=lambda: hub)
    (create, made), (upload, sent) = hub.calls
    assert (create, upload) == ("create_repo", "upload_folder")
    assert (made["repo_id"], made["repo_type"], made["private"]) == ("ada/moving", "dataset", True)
    assert sent["folder_path"] == folder


def test_the_patterns_leave_the_planned_files(folder: Path):
    utils = pytest.importorskip("huggingface_hub.utils")
    for name in (".git/config", "train/.DS_Store", "train/.cache/a.txt", "train/a.txt", ".a.partial-host-1-1"):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("a")
    hub, upload = Hub(), plan_upload(folder, "ada/moving")
    push(folder, upload, private=True, hub=lambda: hub)
    everything = [path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if path.is_file()]
    ignored = hub.calls[-1][1]["ignore_patterns"]
    sent = utils.filter_repo_objects(everything, ignore_patterns=ignored)
    assert tuple(sent) == upload.files


def test_a_refusal_says_what_to_do(folder: Path):
    hub = Hub(OSError("401 Unauthorized\nmore"))
    upload = plan_upload(folder, "ada/moving")
    with pytest.raises(DatagenError, match=r"failed \(401 Unauthorized\)\. Log in with"):
        push(folder, upload, private=True, hub=lambda: hub)


def test_without_the_client_the_extra_is_named(folder: Path, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(UsageError, match=r"pip install 'obpose\[push\]'"):
        push(folder, plan_upload(folder, "ada/moving"), private=True)


@pytest.mark.parametrize("name", ["moving", "ada/", "a/b/c", "../x", "ada/mo ving", "ä/b"])
def test_malformed_names_are_refused(folder: Path, name: str):
    with pytest.raises(UsageError, match="OWNER/NAME"):
        plan_upload(folder, name)


def test_folders_of_something_else_are_refused(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(UsageError, match="holds no dataset"):
        plan_upload(tmp_path, "ada/moving")


def test_the_client_has_the_calls_that_are_used():
    huggingface_hub = pytest.importorskip("huggingface_hub")
    assert {"create_repo", "upload_folder"} <= set(dir(huggingface_hub.HfApi))
