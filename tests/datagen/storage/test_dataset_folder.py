import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress

import h5py
import pytest

from datagen.errors import Busy, CorruptFile, DatagenError, UsageError
from datagen.storage.dataset_folder import filling, settle, write_file
from datagen.storage.locks import FolderLock
from datagen.storage.shard import pack
from datagen.storage.spec import SPEC_FILE, make_spec, read_spec, settings_hash, spec_text
from tests.worlds.generated import random_record, random_spec
from tests.worlds.rendered import write_shard


def spec(seed: int = 0, **splits: int):
    return random_spec(seed=seed, **splits)


def begin(folder, wanted, **options):
    """The spec that a run finds, which then ends well."""
    with filling(folder, wanted, **options) as found:
        return found


def add_scenes(folder, facts, scenes: int, number: int = 0, **changes: object):
    packed = [pack(random_record(seed)) for seed in range(scenes)]
    return write_shard(folder, facts, "train", number, packed, **changes)


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


@pytest.mark.parametrize("name", [".train-00000.h5.partial-elsewhere-1-1", "README.md"])
def test_a_spec_beside_which_there_is_more_stands_in_the_way(tmp_path, name: str):
    begin(tmp_path, spec(train=3))
    (tmp_path / name).write_text("")
    with pytest.raises(UsageError, match="other settings"):
        begin(tmp_path, spec(seed=1, train=3))
    assert sorted(content(tmp_path)) == sorted([name, SPEC_FILE])


def test_the_spec_that_another_job_is_about_to_write_is_left_alone(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    (tmp_path / f".{SPEC_FILE}.partial-elsewhere-1-1").write_text("")
    begin(tmp_path, spec(seed=1, train=3), overwrite=True)
    assert sorted(content(tmp_path)) == [f".{SPEC_FILE}.partial-elsewhere-1-1", SPEC_FILE]


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


def test_overwriting_keeps_scenes_of_the_wanted_settings(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    add_scenes(tmp_path, spec(seed=1), 2, number=1)
    begin(tmp_path, spec(seed=1, train=100), overwrite=True)
    assert sorted(content(tmp_path)) == [SPEC_FILE, "train-00001.h5"]


def test_overwriting_removes_our_files_and_no_others(tmp_path):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    for name in ("manifest.json", "README.md", "preview.png", ".train-00001.h5.partial-elsewhere-1-1"):
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
    old = make_spec(recipe, seed=0, splits={"train": 3}, resolution=(7, 5), renderer=old["renderer"])
    begin(tmp_path, old)
    kept = begin(tmp_path, spec(train=5))
    assert kept["recipe"] == recipe
    assert settings_hash(kept) == settings_hash(old)


@pytest.mark.parametrize("wanted", [2, 200])
def test_a_lost_spec_is_rebuilt_from_the_shards(tmp_path, wanted: int):
    begin(tmp_path, spec(train=67))
    add_scenes(tmp_path, spec(), 3)
    add_scenes(tmp_path, spec(), 3, number=1)
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / SPEC_FILE).unlink()
    before = content(tmp_path)
    assert begin(tmp_path, spec(train=wanted), prove=refuse) == spec(train=max(67, wanted))
    assert content(tmp_path) == {**before, SPEC_FILE: spec_text(spec(train=max(67, wanted))).encode()}


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("damage", ["moved", "damaged"])
def test_a_lost_spec_is_not_rebuilt_from_shards_that_are_not_whole_and_in_place(tmp_path, overwrite: bool, damage: str):
    add_scenes(tmp_path, spec(), 3)
    path = add_scenes(tmp_path, spec(), 3, number=1, **({"first_scene": 0} if damage == "moved" else {}))
    if damage == "damaged":
        with h5py.File(path, "r+") as file:
            del file["depth"]
    before = content(tmp_path)
    with pytest.raises(UsageError, match=r"has no dataset\.json, and it cannot be rebuilt.*train-00001\.h5"):
        begin(tmp_path, spec(train=2), overwrite=overwrite)
    assert content(tmp_path) == before


def test_a_lost_spec_is_not_rebuilt_by_a_command_of_other_settings(tmp_path):
    add_scenes(tmp_path, spec(), 3)
    before = content(tmp_path)
    with pytest.raises(UsageError, match=r"cannot be rebuilt.*train-00000\.h5 belongs to another dataset"):
        begin(tmp_path, spec(seed=1, train=2))
    assert content(tmp_path) == before
    assert begin(tmp_path, spec(seed=1, train=2), overwrite=True) == read_spec(tmp_path) == spec(seed=1, train=2)
    assert sorted(content(tmp_path)) == [SPEC_FILE]


@pytest.mark.parametrize("number", [1, 7])
def test_a_dataset_is_not_extended_around_a_shard_that_belongs_elsewhere(tmp_path, number: int):
    begin(tmp_path, spec(train=3))
    add_scenes(tmp_path, spec(), 3)
    add_scenes(tmp_path, spec(), 3, number=number, first_scene=0)
    before = content(tmp_path)
    with pytest.raises(UsageError, match=f"train-0000{number}.h5 holds scenes of train from scene 0"):
        begin(tmp_path, spec(train=3))
    assert content(tmp_path) == before


@contextmanager
def at_work(folder, wanted) -> Iterator[None]:
    """Another run that fills the folder; locks of one process keep each other out as those of two do."""
    with filling(folder, wanted):
        yield


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_dataset_that_is_being_made_is_neither_given_up_nor_mixed(tmp_path, overwrite: bool):
    with at_work(tmp_path / "new", spec(train=3)):
        add_scenes(tmp_path / "new", spec(), 3)
        before = content(tmp_path / "new")
        with pytest.raises(Busy, match=r"Another obpose-datagen is writing to .*\(seed: 0 -> 1\).*another folder"):
            begin(tmp_path / "new", spec(seed=1, train=1), overwrite=overwrite, prove=refuse)
        assert content(tmp_path / "new") == before
    begin(tmp_path / "new", spec(seed=1, train=1), overwrite=True)


def test_runs_of_the_same_settings_fill_a_folder_side_by_side(tmp_path):
    with at_work(tmp_path, spec(train=3)), at_work(tmp_path, spec(train=5)):
        assert begin(tmp_path, spec(train=2), overwrite=True, prove=refuse) == spec(train=5)


def test_a_run_waits_for_one_that_is_about_to_begin_the_dataset(tmp_path):
    proving, other = threading.Event(), []

    def prove() -> None:
        proving.set()
        time.sleep(0.3)

    def join() -> None:
        proving.wait()
        other.append(begin(tmp_path, spec(train=5), prove=refuse))

    thread = threading.Thread(target=join)
    thread.start()
    with filling(tmp_path, spec(train=3), prove=prove):
        thread.join()
    assert other == [spec(train=5)]


def test_a_run_that_waited_in_vain_begins_the_dataset_itself(tmp_path):
    proving, other = threading.Event(), []

    def prove() -> None:
        proving.set()
        time.sleep(0.3)
        refuse()

    def join() -> None:
        proving.wait()
        other.append(begin(tmp_path / "a" / "b", spec(train=5)))

    thread = threading.Thread(target=join)
    thread.start()
    with pytest.raises(UsageError, match="impossible"):
        begin(tmp_path / "a" / "b", spec(seed=1, train=3), prove=prove)
    thread.join()
    assert other == [spec(train=5)] == [read_spec(tmp_path / "a" / "b")]


def test_a_process_that_never_gets_ready_is_not_waited_for_forever(tmp_path):
    with closing(FolderLock(tmp_path)) as lock:
        assert lock.take_alone()
        with pytest.raises(Busy, match="has been preparing"):
            begin(tmp_path, spec(train=3), patience_seconds=0.1)


def fail(folder, wanted, **options) -> None:
    """A run that fails at its first shard, as on a full disk or by Ctrl-C."""
    with suppress(KeyboardInterrupt), filling(folder, wanted, **options):
        raise KeyboardInterrupt


def test_a_run_that_fails_before_its_first_shard_leaves_nothing_new(tmp_path):
    fail(tmp_path / "a" / "b" / "c", spec(train=3))
    assert content(tmp_path) == {}
    (tmp_path / "empty").mkdir()
    fail(tmp_path / "empty", spec(train=3))
    fail(tmp_path / "empty" / "new", spec(train=3))
    assert content(tmp_path / "empty") == {}
    with pytest.raises(UsageError, match="impossible"):
        begin(tmp_path / "a" / "b", spec(train=3), prove=refuse)
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_a_folder_that_cannot_be_made_leaves_no_parents(tmp_path):
    with pytest.raises(OSError, match="File name too long"):
        begin(tmp_path / "a" / "b" / ("c" * 300), spec(train=3))
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_fails_removes_nothing_that_was_there_or_is_used(tmp_path):
    begin(tmp_path / "bare", spec(train=3))
    fail(tmp_path / "bare", spec(train=9))
    assert read_spec(tmp_path / "bare") == spec(train=9)

    with suppress(KeyboardInterrupt), filling(tmp_path / "new", spec(train=3)):
        add_scenes(tmp_path / "new", spec(), 1)
        raise KeyboardInterrupt
    assert sorted(content(tmp_path / "new")) == [SPEC_FILE, "train-00000.h5"]

    with suppress(KeyboardInterrupt), filling(tmp_path / "shared", spec(train=3)):
        other = at_work(tmp_path / "shared", spec(train=3))
        other.__enter__()
        raise KeyboardInterrupt
    assert sorted(content(tmp_path / "shared")) == [SPEC_FILE]
    other.__exit__(None, None, None)


def test_a_file_is_not_written_into_a_folder_that_another_dataset_has_taken(tmp_path):
    begin(tmp_path, spec(train=3))
    own = settings_hash(spec())
    write_file(tmp_path, "train-00000.h5", b"own", own)
    for text in (spec_text(spec(seed=1, train=3)), "{", None):
        (tmp_path / SPEC_FILE).unlink()
        if text:
            (tmp_path / SPEC_FILE).write_text(text)
        with pytest.raises(DatagenError, match=r"dataset\.json is gone or belongs to another.*train-00000\.h5 was not"):
            write_file(tmp_path, "train-00000.h5", b"other", own)
        assert content(tmp_path).get("train-00000.h5") == b"own"
        assert not list(tmp_path.glob("*.partial*"))
        (tmp_path / SPEC_FILE).touch()


@pytest.mark.parametrize("overwrite", [False, True])
def test_where_there_are_no_locks_a_run_looks_again_before_it_begins(tmp_path, monkeypatch, overwrite: bool):
    def unsupported(_descriptor: int, _kind: int) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", unsupported)
    begun = begin(tmp_path / "same", spec(train=5), overwrite=overwrite, prove=lambda: meanwhile_in(tmp_path / "same"))
    assert begun == spec(train=5)
    assert sorted(content(tmp_path / "same")) == [SPEC_FILE, "train-00000.h5"]
    with pytest.raises(UsageError, match="other settings"):
        begin(tmp_path / "new", spec(seed=1, train=1), prove=lambda: meanwhile_in(tmp_path / "new"))


def meanwhile_in(folder) -> None:
    with at_work(folder, spec(train=3)):
        add_scenes(folder, spec(), 1)


@pytest.mark.parametrize("overwrite", [False, True])
def test_where_there_are_no_locks_datasets_are_made_as_ever(tmp_path, monkeypatch, overwrite: bool):
    def unsupported(_descriptor: int, _kind: int) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr("fcntl.flock", unsupported)
    with at_work(tmp_path / "new", spec(train=3)):
        assert begin(tmp_path / "new", spec(train=5), overwrite=overwrite) == spec(train=5)
        fail(tmp_path / "new", spec(train=3))
    assert read_spec(tmp_path / "new") == spec(train=5)
