import h5py
import numpy as np
import pytest

from datagen import schema
from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.shard import Shard, pack, shard_image
from tests.small import random_record

RECORDS = [random_record(seed) for seed in range(3)]
ATTRIBUTES = {"split": "train", "settings_hash": "0" * 64}


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "train-00000.h5"
    path.write_bytes(shard_image([pack(record) for record in RECORDS], ATTRIBUTES))
    return path


def test_what_is_read_is_what_was_written(path):
    shard = Shard(path)
    assert len(shard) == 3
    assert shard.fields == sorted(RECORDS[0])
    for row, record in enumerate(RECORDS):
        for name, array in record.items():
            read = shard.read(row, name)
            assert read.dtype.kind == array.dtype.kind
            np.testing.assert_array_equal(read, array)
        assert schema.scene_hash({name: shard.read(row, name) for name in shard.fields}) == shard.hashes()[row]


def test_hdf5_itself_compresses_to_the_same_bytes_as_we_do(path, tmp_path):
    for name in ("rgb", "depth", "segmentation"):
        frame = RECORDS[0][name][:1, :1]
        with h5py.File(tmp_path / "peer.h5", "w") as peer, h5py.File(path) as ours:
            peer.create_dataset(
                name, data=frame, chunks=frame.shape, shuffle=True, compression="gzip", compression_opts=4
            )
            offset = (0,) * ours[name].ndim
            assert ours[name].id.read_direct_chunk(offset)[1] == peer[name].id.read_direct_chunk(offset[1:])[1]


def test_the_filters_are_stock_and_a_frame_is_a_chunk(path):
    with h5py.File(path) as file:
        for name in ("rgb", "depth", "segmentation"):
            assert (file[name].shuffle, file[name].compression, file[name].compression_opts) == (True, "gzip", 4)
            assert file[name].chunks[:3] == (1, 1, 1)
            assert file[name].chunks[3:] == file[name].shape[3:]


def test_every_array_says_what_it_is(path):
    with h5py.File(path) as file:
        assert file.attrs["depth_scale"] == schema.DEPTH_SCALE
        assert "OpenCV" in file.attrs["conventions"]
        for name in RECORDS[0]:
            assert {"unit", "frame", "axes", "description"} <= set(file[name].attrs)
            assert len(file[name].attrs["axes"].split()) == file[name].ndim


def test_equal_scenes_give_equal_bytes():
    images = {shard_image([pack(random_record(seed)) for seed in range(2)], {"split": "train"}) for _ in range(2)}
    assert len(images) == 1


def test_scenes_taken_over_from_a_file_give_the_bytes_of_new_ones(path):
    shard = Shard(path)
    taken = [shard.packed(row) for row in range(2)]
    new = [pack(record) for record in RECORDS]
    assert shard_image([*taken, new[2]], {"split": "train"}) == shard_image(new, {"split": "train"})


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_a_truncated_file_is_one_clear_error(path, share: float):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(CorruptFile, match=r"train-00000\.h5 is truncated, damaged or not an HDF5 file"):
        Shard(path)


def test_a_damaged_frame_is_one_clear_error(path):
    with h5py.File(path) as file:
        place = file["rgb"].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[place + 1 : place + 9] = b"\xff" * 8
    path.write_bytes(content)
    with pytest.raises(CorruptFile, match="damaged"):
        Shard(path).read(0, "rgb")
    np.testing.assert_array_equal(Shard(path).read(1, "rgb"), RECORDS[1]["rgb"])


@pytest.mark.parametrize(("place", "name"), [("/", "settings_hash"), ("hash", "fields")])
def test_a_file_without_what_reading_needs_is_one_clear_error(path, place: str, name: str):
    with h5py.File(path, "r+") as file:
        del file[place].attrs[name]
    with pytest.raises(CorruptFile, match=r"train-00000\.h5 .*damaged.*settings_hash or the list of fields is missing"):
        Shard(path)


def test_a_foreign_hdf5_file_is_refused(tmp_path):
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["rgb"] = np.zeros((2, 2))
    with pytest.raises(UsageError, match="not one of obpose-datagen"):
        Shard(tmp_path / "foreign.h5")


def test_a_file_of_a_newer_format_is_refused(path):
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = schema.FORMAT_VERSION + 1
    with pytest.raises(UsageError, match="format version 2"):
        Shard(path)


def test_a_missing_file_is_an_incomplete_dataset(tmp_path):
    with pytest.raises(DatagenError, match="incomplete"):
        Shard(tmp_path / "train-00000.h5")


def test_an_unknown_field_names_those_that_are_there(path):
    with pytest.raises(UsageError, match=r"no field 'flow'.*rgb"):
        Shard(path).read(0, "flow")
