import hashlib
import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.storage.atomic import write_atomically
from datagen.storage.reader import Dataset, Split
from datagen.storage.shard import pack
from datagen.storage.spec import SPEC_FILE, settings_hash, spec_text, with_splits
from tests.worlds.generated import ROOT, random_record, random_spec
from tests.worlds.rendered import write_shard

SPEC = with_splits({**random_spec(), "scenes_per_shard": 2}, {"train": 5, "val": 2})


@pytest.fixture
def folder(tmp_path):
    write_atomically(tmp_path / SPEC_FILE, spec_text(SPEC).encode())
    for split, seeds in {"train": [[0, 1], [2, 3], [4]], "val": [[5, 6]]}.items():
        for number, chosen in enumerate(seeds):
            add_shard(tmp_path, split, number, chosen)
    return tmp_path


def add_shard(folder, split: str, number: int, seeds: list[int]):
    return write_shard(folder, SPEC, split, number, [pack(random_record(seed)) for seed in seeds])


def assert_equal(record, expected):
    assert sorted(record) == sorted(expected)
    for name, array in record.items():
        np.testing.assert_array_equal(array, expected[name])


def test_scenes_are_found_across_shards(folder):
    dataset = Dataset(folder)
    assert dataset.splits == {"train": 5, "val": 2, "test": 0}
    dataset.check_complete()
    for index, record in enumerate(dataset.split("train")):
        assert_equal(record, random_record(index))
    assert_equal(dataset.split("val")[np.int64(1)], random_record(6))
    assert len(dataset.split("train")[1:4]) == 3


@pytest.mark.parametrize("frames", [slice(1, 3), slice(0, 1), slice(None, None, 2), slice(2, 2), None])
def test_only_the_fields_and_frames_asked_for_are_read(folder, frames):
    expected = random_record(3)
    record = Dataset(folder).split("train").read(3, ["rgb", "poses/position", "objects/mass"], frames)
    chosen = frames or slice(None)
    assert list(record) == ["rgb", "poses/position", "objects/mass"]
    np.testing.assert_array_equal(record["rgb"], expected["rgb"][chosen])
    np.testing.assert_array_equal(record["poses/position"], expected["poses/position"][chosen])
    np.testing.assert_array_equal(record["objects/mass"], expected["objects/mass"])


@pytest.mark.parametrize("index", [-1, 5, 2**31, 2**63])
def test_an_index_outside_the_split_is_an_index_error(folder, index: int):
    with pytest.raises(IndexError, match="5 scenes"):
        Dataset(folder).split("train")[index]


def test_a_split_can_be_pickled_while_it_is_open(folder):
    scenes = Dataset(folder).split("train")
    assert_equal(scenes[4], random_record(4))
    assert_equal(pickle.loads(pickle.dumps(scenes))[4], random_record(4))


def test_more_shards_than_may_be_open_are_read(folder):
    scenes = Split(folder, SPEC, "train", most_open=1)
    for index in (0, 4, 1, 3, 0):
        assert_equal(scenes[index], random_record(index))
        assert len([path for path in Path("/proc/self/fd").iterdir() if path.resolve().parent == folder]) == 1


def test_a_shard_is_checked_again_only_if_its_file_has_changed(folder):
    scenes = Dataset(folder).split("train")
    for index in (0, 2):
        scenes[index]
    scenes.close()
    first = folder / "train-00000.h5"
    shutil.copy(first, folder / "train-00001.h5")
    # Bytes that a check refuses, in a file that looks the same.
    time = first.stat().st_mtime_ns
    first.write_bytes(first.read_bytes().replace(settings_hash(SPEC).encode(), 64 * b"0"))
    os.utime(first, ns=(time, time))
    assert_equal(scenes[0], random_record(0))
    with pytest.raises(UsageError, match="It was copied"):
        scenes[2]
    with pytest.raises(UsageError, match="belongs to another dataset"):
        Dataset(folder).split("train")[0]


def test_an_unknown_split_names_those_that_there_are(folder):
    with pytest.raises(UsageError, match="train, val, test"):
        Dataset(folder).split("validation")


def test_missing_scenes_are_counted_and_the_others_can_be_read(folder):
    (folder / "train-00000.h5").unlink()
    add_shard(folder, "train", 1, [2])
    dataset = Dataset(folder)
    assert dataset.split("train").missing() == [0, 1, 3]
    with pytest.raises(DatagenError, match="3 of 5 train scenes are missing"):
        dataset.check_complete()
    for index in (0, 3):
        with pytest.raises(DatagenError, match="incomplete"):
            dataset.split("train")[index]
    assert_equal(dataset.split("train")[4], random_record(4))


def swap(folder, first: str, second: str) -> None:
    (folder / first).rename(folder / "other")
    (folder / second).rename(folder / first)
    (folder / "other").rename(folder / second)


@pytest.mark.parametrize(
    ("displace", "split"),
    [
        (lambda folder: shutil.copy(folder / "train-00000.h5", folder / "train-00001.h5"), "train"),
        (lambda folder: swap(folder, "train-00000.h5", "train-00001.h5"), "train"),
        (lambda folder: swap(folder, "train-00000.h5", "val-00000.h5"), "train"),
        (lambda folder: swap(folder, "train-00000.h5", "val-00000.h5"), "val"),
        (lambda folder: shutil.copy(folder / "val-00000.h5", folder / "test-00000.h5"), "test"),
        (lambda folder: shutil.copy(folder / "val-00000.h5", folder / "test-00007.h5"), "test"),
        (lambda folder: shutil.copy(folder / "train-00000.h5", folder / "train-00003.h5"), "train"),
    ],
)
def test_a_shard_that_was_copied_renamed_or_swapped_is_refused(folder, displace, split: str):
    displace(folder)
    dataset = Dataset(folder)
    with pytest.raises(UsageError, match=rf"{split}-0000\d\.h5 holds scenes of .*; expected {split} from scene"):
        list(dataset.split(split))
    with pytest.raises(UsageError, match="holds scenes of"):
        dataset.check_complete()


def test_shards_beyond_the_scenes_that_the_dataset_has_yet_are_no_fault(folder):
    add_shard(folder, "train", 7, [7, 8])
    add_shard(folder, "train", 2, [4, 5])
    dataset = Dataset(folder)
    dataset.check_complete()
    assert len(dataset.split("train")) == 5
    assert_equal(dataset.split("train")[4], random_record(4))


def test_a_lost_spec_is_named_where_there_are_shards(folder):
    (folder / SPEC_FILE).unlink()
    with pytest.raises(
        UsageError, match=r"dataset\.json is missing beside train-00000\.h5, .*, \.\.\.\. Run the command"
    ):
        Dataset(folder)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        (None, UsageError, "holds no dataset"),
        ("{", CorruptFile, "damaged"),
        ("[1]", UsageError, "not written by obpose-datagen"),
        ('{"generator": "someone"}', UsageError, "not written by obpose-datagen"),
        ('{"generator": "obpose-datagen", "format_version": 99}', UsageError, "format version 99"),
        ('{"generator": "obpose-datagen", "format_version": 1, "seed": 1}', CorruptFile, "changed"),
    ],
)
def test_a_folder_that_is_no_dataset_is_one_clear_error(tmp_path, text, error, message: str):
    if text is not None:
        (tmp_path / SPEC_FILE).write_text(text)
    with pytest.raises(error, match=message):
        Dataset(tmp_path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("splits", None),
        ("splits", {"train": 1}),
        ("splits", {"train": 10**18, "val": 0, "test": 0}),
        ("splits", {"train": True, "val": 0, "test": 0}),
        ("splits", {"train": 1, "val": "two", "test": 0}),
        ("scenes_per_shard", 0),
        ("scenes_per_shard", 10**12),
        ("seed", "one"),
        ("resolution", [64]),
        ("resolution", 64),
        ("resolution", [0, 64]),
        ("resolution", {"0": 1, "1": 2}),
        ("renderer", "raster"),
        ("rig", {}),
        ("rig", {"views": 10**12, "rig": {}}),
        ("recipe", []),
        ("recipe", {"frames": "ten", "views": 1}),
        ("recipe", {**SPEC["recipe"], "frames": 10**9}),
        ("recipe", {**SPEC["recipe"], "fps": 0}),
        ("recipe", {**SPEC["recipe"], "fps": "12"}),
        ("recipe", {**SPEC["recipe"], "sensor": None}),
        ("recipe", {**SPEC["recipe"], "name": ["moving"]}),
        ("recipe", {**SPEC["recipe"], "name": "\ud800"}),
        ("recipe", {**SPEC["recipe"], "parts": 3}),
        ("recipe", {**SPEC["recipe"], "objects": {"maximum": 10**9}}),
        ("data_version", None),
        ("data_version", "1"),
        ("edits", "move"),
        ("edits", ["paint"]),
    ],
)
def test_a_spec_that_says_nonsense_is_one_clear_error_though_its_hash_fits(tmp_path, key: str, value):
    others = {name: content for name, content in SPEC.items() if name not in (key, "spec_hash")}
    values = others if value is None else {**others, key: value}
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    spec = {**values, "spec_hash": hashlib.sha256(text.encode()).hexdigest()}
    (tmp_path / SPEC_FILE).write_text(spec_text(spec))
    with pytest.raises(CorruptFile, match=rf"no spec: {key} missing or malformed"):
        Dataset(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"generator": "obpose-datagen", "seed": NaN}', "holds NaN"),
        ('{"generator": "obpose-datagen", "seed": 1e999}', "holds 1e999"),
        ("[" * 100_000, "nested"),
        ("9" * 10_000, "damaged"),
        ("\udcff", "not UTF-8"),
    ],
)
def test_a_damaged_spec_says_how_it_is_mended(folder, text: str, message: str):
    (folder / SPEC_FILE).write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(CorruptFile, match=rf"dataset\.json .*{message}.*delete it and run the command"):
        Dataset(folder)


def test_images_that_no_memory_can_hold_are_refused(tmp_path):
    huge = {**SPEC["recipe"], "frames": 10_000, "views": 360}
    others = {name: content for name, content in SPEC.items() if name not in ("recipe", "spec_hash")}
    spec = {**others, "recipe": huge, "resolution": [4096, 4096]}
    text = json.dumps(spec, sort_keys=True, separators=(",", ":"))
    (tmp_path / SPEC_FILE).write_text(spec_text({**spec, "spec_hash": hashlib.sha256(text.encode()).hexdigest()}))
    with pytest.raises(CorruptFile, match="its scenes have more than"):
        Dataset(tmp_path)


def test_a_stranger_reads_a_scene_with_numpy_and_h5py_alone(folder):
    code = (
        "import sys; from datagen.storage.reader import Dataset\n"
        f"scene = Dataset({str(folder)!r}).split('train')[0]; assert scene['rgb'].shape == (3, 2, 5, 7, 3)\n"
        "heavy = {'numba', 'pybullet', 'torch', 'scipy', 'trimesh', 'jaxtyping', 'joblib', 'tyro', 'rich'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (result.stdout, result.stderr) == ("[]\n", "")
