import os
import socket
import subprocess
import sys
import time

import pytest

from datagen.config import load_recipe, recipe_to_dict
from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.folder import begin, settle, write_whole
from datagen.shard import pack, shard_image
from datagen.spec import SPEC_FILE, make_spec, read_spec, settings_hash, shard_name, spec_text
from tests.small import random_record


def spec(seed: int = 0, **splits: int):
    recipe = recipe_to_dict(load_recipe("moving"))
    return make_spec(recipe, seed=seed, splits=splits, resolution=(7, 5), renderer=None)


def add_scenes(folder, facts, scenes: int, number: int = 0):
    image = shard_image([pack(random_record(seed)) for seed in range(scenes)], {"settings_hash": settings_hash(facts)})
    write_whole(folder / shard_name("train", number), image)


def refuse() -> None:
    raise UsageError("this request is impossible")


def content(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_new_folder_gets_its_spec_with_its_parents(tmp_path):
    folder = tmp_path / "a" / "b"
    assert begin(folder, spec(train=3)) == spec(train=3) == read_spec(folder)


def test_the_spec_grows_and_never_shrinks(tmp_path):
    begin(tmp_path, spec(train=9))
    assert begin(tmp_path, spec(train=2, val=1))["splits"] == {"train": 9, "val": 1, "test": 0}
    assert begin(tmp_path, spec(train=100))["splits"]["train"] == 100


def test_a_spec_that_another_run_made_smaller_is_put_right_by_what_is_there_and_wanted(tmp_path):
    begin(tmp_path, spec(train=2))
    add_scenes(tmp_path, spec(), 3, number=1)
    assert settle(tmp_path, spec(val=1))["splits"] == {"train": 67, "val": 1, "test": 0}
    assert settle(tmp_path, spec(train=130)) == read_spec(tmp_path) == spec(train=130, val=1)


def test_other_settings_are_refused_and_nothing_is_touched(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 1)
    before = content(tmp_path)
    with pytest.raises(UsageError, match=r"other settings \(seed: 0 -> 1\).*--overwrite"):
        begin(tmp_path, spec(seed=1, train=3))
    assert content(tmp_path) == before


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_spec_that_a_failed_run_left_alone_stands_in_nobodys_way(tmp_path, overwrite: bool):
    begin(tmp_path, spec(train=3))
    assert begin(tmp_path, spec(seed=1, train=2), overwrite=overwrite) == read_spec(tmp_path) == spec(seed=1, train=2)


@pytest.mark.parametrize("name", ["train-00000.h5.partial-elsewhere-1", "README.md"])
def test_a_spec_beside_which_there_is_more_stands_in_the_way(tmp_path, name: str):
    begin(tmp_path, spec(train=3))
    (tmp_path / name).write_text("")
    with pytest.raises(UsageError, match="other settings"):
        begin(tmp_path, spec(seed=1, train=3))
    assert sorted(content(tmp_path)) == sorted([name, SPEC_FILE])


def test_the_spec_that_another_job_is_about_to_write_is_left_alone(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    (tmp_path / f"{SPEC_FILE}.partial-elsewhere-1").write_text("")
    begin(tmp_path, spec(seed=1, train=3), overwrite=True)
    assert sorted(content(tmp_path)) == [SPEC_FILE, f"{SPEC_FILE}.partial-elsewhere-1"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_request_that_cannot_be_met_leaves_a_folder_as_it_is(tmp_path, overwrite: bool):
    with pytest.raises(UsageError, match="impossible"):
        begin(tmp_path, spec(train=3), overwrite=overwrite, prove=refuse)
    assert content(tmp_path) == {}
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    before = content(tmp_path)
    with pytest.raises(UsageError):
        begin(tmp_path, spec(seed=1, train=3), overwrite=overwrite, prove=refuse)
    assert content(tmp_path) == before


def test_overwriting_goes_on_with_a_dataset_of_the_same_settings(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    before = content(tmp_path)
    begin(tmp_path, spec(train=3), overwrite=True, prove=refuse)
    assert content(tmp_path) == before


def test_overwriting_keeps_what_another_job_of_the_same_command_has_made_meanwhile(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    new = spec(seed=1, train=100)

    def another_job() -> None:
        begin(tmp_path, new, overwrite=True)
        add_scenes(tmp_path, new, 2, number=1)

    begin(tmp_path, new, overwrite=True, prove=another_job)
    assert sorted(content(tmp_path)) == [SPEC_FILE, "train-00001.h5"]
    add_scenes(tmp_path, spec(), 3)
    (tmp_path / SPEC_FILE).write_text(spec_text(spec(train=3)))
    begin(tmp_path, new, overwrite=True)
    assert sorted(content(tmp_path)) == [SPEC_FILE, "train-00001.h5"]


def test_overwriting_removes_our_files_and_no_others(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    for name in ("manifest.json", "README.md", "preview.png", "train-00001.h5.partial-elsewhere-1"):
        (tmp_path / name).write_text("ours")
    for name in ("leaderboard.csv", "train.h5", "train-1.h5", "notes-train-00000.h5"):
        (tmp_path / name).write_text("not ours")
    begin(tmp_path, spec(seed=1, train=1), overwrite=True)
    assert sorted(content(tmp_path)) == [SPEC_FILE, "leaderboard.csv", "notes-train-00000.h5", "train-1.h5", "train.h5"]
    assert read_spec(tmp_path)["seed"] == 1


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_of_other_things_is_never_touched(tmp_path, overwrite: bool):
    (tmp_path / "train-00000.h5").write_text("someone's")
    with pytest.raises(UsageError, match="holds no dataset but 1 other files"):
        begin(tmp_path, spec(train=3), overwrite=overwrite)
    assert content(tmp_path) == {"train-00000.h5": b"someone's"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_dataset_of_another_program_is_never_touched(tmp_path, overwrite: bool):
    (tmp_path / SPEC_FILE).write_text('{"generator": "another"}')
    with pytest.raises(UsageError, match="not written by"):
        begin(tmp_path, spec(train=3), overwrite=overwrite)
    assert sorted(content(tmp_path)) == [SPEC_FILE]


def test_a_file_in_the_folders_place_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(UsageError, match="there is a file in its place"):
            begin(folder, spec(train=3))


@pytest.mark.parametrize("shard", [None, b"someone's"])
def test_a_folder_whose_spec_is_mere_text_is_ours_only_if_a_shard_says_so(tmp_path, shard: bytes | None):
    for name in (SPEC_FILE, "README.md", "preview.png"):
        (tmp_path / name).write_text("someone's")
    if shard:
        (tmp_path / "train-00000.h5").write_bytes(shard)
    before = content(tmp_path)
    with pytest.raises(UsageError, match="no shard beside it"):
        begin(tmp_path, spec(train=3), overwrite=True)
    assert content(tmp_path) == before


def test_a_damaged_spec_can_only_be_overwritten(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(seed=1), 3)
    (tmp_path / SPEC_FILE).write_text("{")
    with pytest.raises(CorruptFile):
        begin(tmp_path, spec(train=3))
    assert begin(tmp_path, spec(train=3), overwrite=True) == read_spec(tmp_path)


def test_constants_that_are_newer_than_the_dataset_are_at_their_defaults(tmp_path):
    old = spec(train=3)
    recipe = dict(old["recipe"])
    del recipe["attempts"]
    old = make_spec(recipe, seed=0, splits={"train": 3}, resolution=(7, 5), renderer=None)
    begin(tmp_path, old)
    kept = begin(tmp_path, spec(train=5))
    assert kept["recipe"] == recipe
    assert settings_hash(kept) == settings_hash(old)


def test_partial_files_of_dead_writers_are_removed_and_those_of_living_ones_kept(tmp_path):
    begin(tmp_path, spec(train=3))
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    host, old = socket.gethostname(), time.time() - 7200
    names = {
        f"train-00000.h5.partial-{host}-{dead.stdout.strip()}": False,
        f"train-00000.h5.partial-{host}-{os.getppid()}": True,
        "train-00000.h5.partial-elsewhere-1": True,
        "val-00000.h5.partial-elsewhere-2": False,
        "novel.txt.partial-elsewhere-2": True,
    }
    for name in names:
        (tmp_path / name).write_text("")
        if name.endswith("-2"):
            os.utime(tmp_path / name, (old, old))
    begin(tmp_path, spec(train=3))
    assert {name: (tmp_path / name).exists() for name in names} == names


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = tmp_path / "train-00000.h5"
    write_whole(path, b"old")

    def no_space(_handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", no_space)
    with pytest.raises(DatagenError, match=r"Cannot write .*train-00000\.h5: No space left on device"):
        write_whole(path, b"new")
    assert content(tmp_path) == {"train-00000.h5": b"old"}
