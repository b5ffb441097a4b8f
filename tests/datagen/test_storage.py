import hashlib
import json
import pickle
import shutil
import subprocess
import sys

import numpy as np
import pytest

from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.folder import write_whole
from datagen.shard import pack, shard_image
from datagen.spec import SPEC_FILE, make_spec, settings_hash, shard_name, spec_text, with_splits
from datagen.storage import Dataset
from tests.small import ROOT, random_record

SPEC = {
    **make_spec({"frames": 3, "views": 2}, seed=0, splits={"train": 5, "val": 2}, resolution=(7, 5), renderer=None),
    "scenes_per_shard": 2,
}
SPEC = with_splits(SPEC, SPEC["splits"])


@pytest.fixture
def folder(tmp_path):
    write_whole(tmp_path / SPEC_FILE, spec_text(SPEC).encode())
    for split, seeds in {"train": [[0, 1], [2, 3], [4]], "val": [[5, 6]]}.items():
        for number, chosen in enumerate(seeds):
            scenes = [pack(random_record(seed)) for seed in chosen]
            image = shard_image(scenes, {"settings_hash": settings_hash(SPEC)})
            (tmp_path / shard_name(split, number)).write_bytes(image)
    return tmp_path


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


def test_more_shards_than_may_be_open_are_read(folder, monkeypatch):
    monkeypatch.setattr("datagen.storage._MOST_OPEN_FILES", 1)
    scenes = Dataset(folder).split("train")
    for index in (0, 4, 1, 3, 0):
        assert_equal(scenes[index], random_record(index))


def test_an_unknown_split_names_those_that_there_are(folder):
    with pytest.raises(UsageError, match="train, val, test"):
        Dataset(folder).split("validation")


def test_missing_scenes_are_counted_and_the_others_can_be_read(folder):
    (folder / "train-00000.h5").unlink()
    shutil.copy(folder / "train-00002.h5", folder / "train-00001.h5")
    dataset = Dataset(folder)
    assert dataset.split("train").missing() == [0, 1, 3]
    with pytest.raises(DatagenError, match="3 of 5 train scenes are missing"):
        dataset.check_complete()
    for index in (0, 3):
        with pytest.raises(DatagenError, match="incomplete"):
            dataset.split("train")[index]
    assert_equal(dataset.split("train")[4], random_record(4))


def test_a_shard_of_another_dataset_is_refused(folder):
    image = shard_image([pack(random_record(0))], {"settings_hash": "0" * 64})
    (folder / "train-00000.h5").write_bytes(image)
    with pytest.raises(UsageError, match="belongs to another dataset"):
        Dataset(folder).split("train")[0]


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
        ("splits", {"train": 1, "val": "two", "test": 0}),
        ("scenes_per_shard", 0),
        ("seed", "one"),
        ("resolution", [64]),
        ("resolution", 64),
        ("renderer", "raster"),
        ("rig", {}),
        ("recipe", []),
        ("recipe", {"frames": "ten", "views": 1}),
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


def test_a_stranger_reads_a_scene_with_numpy_and_h5py_alone(folder):
    code = (
        "import sys; from datagen.storage import Dataset\n"
        f"scene = Dataset({str(folder)!r}).split('train')[0]; assert scene['rgb'].shape == (3, 2, 5, 7, 3)\n"
        "heavy = {'numba', 'pybullet', 'torch', 'scipy', 'trimesh', 'jaxtyping', 'joblib', 'tyro', 'rich'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (result.stdout, result.stderr) == ("[]\n", "")
