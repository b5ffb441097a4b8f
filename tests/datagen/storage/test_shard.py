import struct
import sys
import zlib

import h5py
import numpy as np
import pytest

from datagen import schema
from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.storage.shard import Shard, _write_array, pack, scenes_present, shard_image, shard_settings
from datagen.storage.spec import make_spec, settings_hash
from tests.worlds.generated import random_record, random_spec
from tests.worlds.rendered import write_shard

RECORDS = [random_record(seed) for seed in range(3)]
SPEC = random_spec(train=3)


@pytest.fixture
def path(tmp_path):
    return write_shard(tmp_path, SPEC, "train", 0, [pack(record) for record in RECORDS])


def opened(path, **options):
    return Shard(path.parent, SPEC, "train", 0, **options)


def test_what_is_read_is_what_was_written(path):
    shard = opened(path)
    shard.check()
    assert len(shard) == 3
    assert shard.fields == sorted(RECORDS[0])
    for row, record in enumerate(RECORDS):
        for name, array in record.items():
            read = shard.read(row, name)
            assert read.dtype.kind == array.dtype.kind
            np.testing.assert_array_equal(read, array)
        assert schema.scene_hash({name: shard.read(row, name) for name in shard.fields}) == shard.hashes()[row]


@pytest.mark.parametrize("name", ["rgb", "poses/position"])
def test_scenes_whose_arrays_differ_in_shape_share_no_shard(name: str):
    longer = {**RECORDS[1], name: np.concatenate([RECORDS[1][name]] * 2)}
    with pytest.raises(DatagenError, match=f"{name} has shapes .* and .* in scenes of one shard"):
        shard_image([pack(RECORDS[0]), pack(longer)], {})


def test_hdf5_itself_reads_what_we_compress(path):
    with h5py.File(path) as file:
        for name in ("rgb", "depth", "segmentation"):
            np.testing.assert_array_equal(file[name][:], [record[name] for record in RECORDS])


@pytest.mark.parametrize(("packed", "filter_mask"), [(bytes, 0b11), (zlib.compress, 0b01)])
def test_frames_without_some_of_the_filters_are_read(path, packed, filter_mask: int):
    with h5py.File(path, "r+") as file:
        first = RECORDS[0]["depth"][:1, :1].tobytes()
        file["depth"].id.write_direct_chunk((0,) * 5, packed(first), filter_mask=filter_mask)
    np.testing.assert_array_equal(opened(path).read(0, "depth"), RECORDS[0]["depth"])


@pytest.mark.parametrize("chunk", [zlib.compress(b"short"), zlib.compress(bytes(10**6)), b"damaged"])
@pytest.mark.parametrize("name", ["depth", "poses/position"])
def test_chunks_that_do_not_unpack_to_their_size_are_reported(path, name: str, chunk: bytes):
    with h5py.File(path, "r+") as file:
        file[name].id.write_direct_chunk((0,) * file[name].ndim, chunk)
    with pytest.raises(CorruptFile, match="has a chunk that does not unpack to its"):
        opened(path).read(0, name)


def test_frames_are_not_read_from_huge_chunks(path):
    with h5py.File(path, "r+") as file:
        (_, chunk), most = file["depth"].id.read_direct_chunk((0,) * 5), 2000
        file["depth"].id.write_direct_chunk((0,) * 5, chunk + bytes(most))
    np.testing.assert_array_equal(opened(path).read(0, "depth"), RECORDS[0]["depth"])
    with pytest.raises(CorruptFile, match="has a chunk that does not unpack to its 70 bytes"):
        opened(path, most_bytes=most).read(0, "depth")


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
    shard = opened(path)
    taken = [shard.packed(row) for row in range(2)]
    new = [pack(record) for record in RECORDS]
    assert shard_image([*taken, new[2]], {"split": "train"}) == shard_image(new, {"split": "train"})


@pytest.mark.parametrize("options", [{"compression": "gzip"}, {"compression": "lzf"}, {"chunks": (3, 3, 2, 5, 7)}])
def test_scenes_are_taken_over_from_a_file_that_another_program_packed(path, options: dict):
    with h5py.File(path, "r+") as file:
        depth = file["depth"][:]
        del file["depth"]
        file.create_dataset("depth", data=depth, **{"chunks": (1, 1, 1, 5, 7), "compression": "gzip", **options})
    np.testing.assert_array_equal(opened(path).read(1, "depth"), RECORDS[1]["depth"])
    taken = [opened(path).packed(row) for row in range(3)]
    new = [pack(record) for record in RECORDS]
    assert shard_image(taken, {"split": "train"}) == shard_image(new, {"split": "train"})


def lz4_spec(**splits: int):
    facts = {key: SPEC[key] for key in ("seed", "resolution", "renderer")}
    return make_spec(SPEC["recipe"], splits=splits, compression="lz4", **facts)


@pytest.fixture
def lz4_path(tmp_path):
    pytest.importorskip("hdf5plugin")
    facts = lz4_spec(train=3)
    return write_shard(tmp_path, facts, "train", 0, [pack(record, "lz4") for record in RECORDS])


def test_scenes_compressed_with_lz4_are_those_compressed_with_gzip(lz4_path):
    shard = Shard(lz4_path.parent, lz4_spec(train=3), "train", 0)
    shard.check()
    assert shard.hashes() == [pack(record).hash for record in RECORDS]
    for row, record in enumerate(RECORDS):
        for name, array in record.items():
            np.testing.assert_array_equal(shard.read(row, name), array)
    np.testing.assert_array_equal(shard.read(1, "rgb", slice(1, 2)), RECORDS[1]["rgb"][1:2])
    taken = [shard.packed(row) for row in range(3)]
    assert shard_image(taken, {}) == shard_image([pack(record, "lz4") for record in RECORDS], {})


def test_huge_lz4_chunks_are_refused(lz4_path):
    with h5py.File(lz4_path, "r+") as file:
        # The layout is right: the size, that of a block, and the length of the only block.
        file["rgb"].id.write_direct_chunk((0,) * 6, struct.pack(">QII", 105, 105, 2000) + bytes(2000))
    with pytest.raises(CorruptFile, match="a chunk that does not unpack to its 105 bytes"):
        Shard(lz4_path.parent, lz4_spec(train=3), "train", 0).read(0, "rgb")


def test_lz4_without_its_package_says_what_to_install(lz4_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    with pytest.raises(UsageError, match=r"pip install 'obpose\[lz4\]'"):
        pack(RECORDS[0], "lz4")
    with pytest.raises(UsageError, match=r"pip install 'obpose\[lz4\]'"):
        Shard(lz4_path.parent, lz4_spec(train=3), "train", 0)


@pytest.mark.parametrize(
    "chunk",
    [
        b"short",
        struct.pack(">QII", 2**40, 105, 105) + bytes(105),
        struct.pack(">QII", 105, 0, 105) + bytes(105),
        struct.pack(">QII", 105, 105, 105) + bytes(50),
        struct.pack(">QII", 105, 105, 50) + bytes(105),
        struct.pack(">QII", 105, 60, 60) + bytes(60),
    ],
)
def test_lz4_chunks_of_wrong_lengths_are_refused(lz4_path, chunk: bytes):
    with h5py.File(lz4_path, "r+") as file:
        assert file["rgb"].chunks == (1, 1, 1, 5, 7, 3)
        file["rgb"].id.write_direct_chunk((0,) * 6, chunk)
    shard = Shard(lz4_path.parent, lz4_spec(train=3), "train", 0)
    np.testing.assert_array_equal(shard.read(1, "rgb"), RECORDS[1]["rgb"])
    with pytest.raises(CorruptFile, match="a chunk that does not unpack to its 105 bytes"):
        shard.read(0, "rgb")


def test_filters_of_other_packages_are_refused(path):
    hdf5plugin = pytest.importorskip("hdf5plugin")
    with h5py.File(path, "r+") as file:
        depth = file["depth"][:]
        del file["depth"]
        file.create_dataset("depth", data=depth, **hdf5plugin.Zstd())
    with pytest.raises(CorruptFile, match="depth is packed with HDF5 filter 32015; expected gzip or lz4"):
        opened(path).check()


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_a_truncated_file_is_one_clear_error(path, share: float):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(CorruptFile, match=r"train-00000\.h5 is truncated, damaged or not an HDF5 file"):
        opened(path)


def test_a_damaged_frame_is_one_clear_error(path):
    with h5py.File(path) as file:
        place = file["rgb"].id.get_chunk_info(0).byte_offset
    content = bytearray(path.read_bytes())
    content[place + 1 : place + 9] = b"\xff" * 8
    path.write_bytes(content)
    with pytest.raises(CorruptFile, match="damaged"):
        opened(path).read(0, "rgb")
    np.testing.assert_array_equal(opened(path).read(1, "rgb"), RECORDS[1]["rgb"])


@pytest.mark.parametrize("place", ["/", "hash"])
def test_a_file_without_an_attribute_that_reading_needs_is_one_clear_error(path, place: str):
    names = ("fields",) if place == "hash" else ("settings_hash", "split", "first_scene", "data_version", "depth_scale")
    content = path.read_bytes()
    for name in names:
        path.write_bytes(content)
        with h5py.File(path, "r+") as file:
            del file[place].attrs[name]
        with pytest.raises(CorruptFile, match=rf"train-00000\.h5 .*damaged.*attribute {name} is missing.*Delete it"):
            opened(path)


@pytest.mark.parametrize("name", ["settings_hash", "split", "first_scene", "data_version", "depth_scale"])
@pytest.mark.parametrize("value", [[1, 2], 1.5, b"\xff", h5py.Empty("f")])
def test_an_attribute_of_another_type_is_one_clear_error(path, name: str, value: object):
    with h5py.File(path, "r+") as file:
        file.attrs[name] = value
    with pytest.raises(CorruptFile, match="Delete it and run the command"):
        opened(path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"settings_hash": "0" * 64}, "belongs to another dataset"),
        ({"split": "val"}, "holds scenes of val from scene 0 on; expected train from scene 0 on"),
        ({"first_scene": 64}, "holds scenes of train from scene 64 on; expected train from scene 0 on"),
    ],
)
def test_a_shard_that_belongs_elsewhere_is_refused(path, changes: dict, message: str):
    write_shard(path.parent, SPEC, "train", 0, [pack(RECORDS[0])], **changes)
    with pytest.raises(UsageError, match=rf"train-00000\.h5 {message}.*Move it away"):
        opened(path)


@pytest.mark.parametrize("changes", [{"data_version": 99}, {"depth_scale": 1e-3}])
def test_a_shard_whose_arrays_mean_something_else_is_refused(path, changes: dict):
    write_shard(path.parent, SPEC, "train", 0, [pack(RECORDS[0])], **changes)
    with pytest.raises(CorruptFile, match=f"attribute {next(iter(changes))} is "):
        opened(path)


def test_a_shard_with_more_scenes_than_it_may_have_is_refused(path):
    few = {**SPEC, "scenes_per_shard": 2}
    write_shard(path.parent, few, "train", 0, [pack(record) for record in RECORDS])
    with pytest.raises(CorruptFile, match=r"hash has 3 values .* expected 1 to 2"):
        Shard(path.parent, few, "train", 0)


def replace(file: h5py.File, name: str, **options: object) -> None:
    del file[name]
    file.create_dataset(name, **options)


def link(file: h5py.File, name: str, target: object) -> None:
    del file[name]
    file[name] = target


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: file.__delitem__("depth"), "depth is missing"),
        (lambda file: (file.__delitem__("depth"), file.create_group("depth")), "depth is a group"),
        (lambda file: (file.__delitem__("objects"), file.create_dataset("objects", data=1)), "link"),
        (lambda file: link(file, "depth", h5py.SoftLink("/rgb")), "depth is a link"),
        (lambda file: link(file, "depth", h5py.SoftLink("/depth")), "depth is a link"),
        (lambda file: link(file, "depth", h5py.ExternalLink("other.h5", "/rgb")), "depth is a link"),
        (lambda file: link(file, "objects", h5py.ExternalLink("other.h5", "/objects")), "objects is a link"),
        (lambda file: link(file, "depth", file["segmentation"]), "depth has dtype uint8, expected uint16"),
        (lambda file: replace(file, "depth", shape=(3,), dtype="u2"), "depth has shape"),
        (lambda file: replace(file, "depth", shape=(), dtype="u2"), "depth has shape"),
        (lambda file: replace(file, "depth", shape=(3, 3, 2, 5, 8), dtype="u2"), "axis width has length 8, expected 7"),
        (lambda file: replace(file, "depth", shape=(2, 3, 2, 5, 7), dtype="u2"), "expected 3 scenes"),
        (lambda file: replace(file, "depth", shape=(3, 3, 2, 5, 7), dtype=">u2"), "expected uint16"),
        (lambda file: replace(file, "depth", shape=(3, 3, 2, 5, 7), dtype=[("a", "u2")]), "depth has type"),
        (lambda file: replace(file, "depth", dtype=h5py.string_dtype(), shape=(3, 3, 2, 5, 7)), "depth has type"),
        (lambda file: replace(file, "objects/mass", shape=(3, 10**12), dtype="f4"), "expected"),
        (lambda file: replace(file, "scene/description", shape=(3,), dtype="S2000000"), "texts of 2000000 letters"),
        (
            lambda file: replace(
                file, "depth", shape=(3, 3, 2, 5, 7), maxshape=(None,) * 5, chunks=(1, 1, 1, 999, 999), dtype="u2"
            ),
            "depth has chunks of shape",
        ),
        (
            lambda file: replace(file, "depth", shape=(3, 3, 2, 5, 7), dtype="u2", external=[("/etc/passwd", 0, 2520)]),
            "depth keeps its data in another file",
        ),
    ],
)  # fmt: skip
def test_an_array_that_is_not_of_the_format_is_one_clear_error(path, change, message: str):
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(CorruptFile, match=f"{message}.*Delete it and run the command"):
        opened(path).check()


@pytest.mark.parametrize("values", [np.zeros((3, 2), "S64"), np.zeros(3, "S63"), np.zeros(3), np.zeros(0, "S64"), 1])
def test_hashes_that_are_none_are_one_clear_error(path, values: object):
    with h5py.File(path, "r+") as file:
        fields = file["hash"].attrs["fields"]
        del file["hash"]
        file["hash"] = values
        file["hash"].attrs["fields"] = fields
    with pytest.raises(CorruptFile, match="hash has"):
        opened(path)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("objects/count", np.array([1, 5, 2], "u1"), "objects/count is 5, expected at most 4"),
        ("objects/category", np.array([[b"box\xff"] * 4] * 3), "text with bytes that are not printable ASCII"),
        ("objects/category", np.array([[b"\x1b[31m"] * 4] * 3), "text with bytes that are not printable ASCII"),
    ],
)
def test_values_that_readers_trust_are_checked(path, name: str, value: np.ndarray, message: str):
    with h5py.File(path, "r+") as file:
        replace(file, name, data=value)
    with pytest.raises(CorruptFile, match=message):
        opened(path).read(1, name)


@pytest.mark.parametrize("text", [b"{", b"[1]", b'{"left": "two"}', b'{"left": -1}', b'{"left": NaN}', b"[" * 1000])
def test_rejections_that_are_none_are_one_clear_error(tmp_path, text: bytes):
    record = {**RECORDS[0], "scene/rejections": np.asarray(text)}
    write_shard(tmp_path, SPEC, "train", 0, [pack(record)])
    with pytest.raises(CorruptFile, match=r"train-00000\.h5 .*Delete it"):
        Shard(tmp_path, SPEC, "train", 0).rejections(0)


@pytest.mark.parametrize(
    ("most", "chunk"), [(10**6, (3, 3, 5, 5)), (700, (2, 3, 5, 5)), (299, (1, 2, 5, 5)), (60, (1, 1, 5, 5))]
)
def test_large_tables_are_stored_in_chunks_that_can_be_read(tmp_path, most: int, chunk: tuple[int, ...]):
    table = np.stack([record["contacts/gap"] for record in RECORDS])
    with h5py.File(tmp_path / "a.h5", "w") as file:
        stored = _write_array(file, "contacts/gap", table, most)
        assert stored.chunks == chunk
        np.testing.assert_array_equal(stored[:], table)


def test_a_field_of_a_later_version_is_read_as_it_is(path):
    with h5py.File(path, "r+") as file:
        file["later"] = np.arange(6.0).reshape(3, 2)
        file["hash"].attrs["fields"] += " later"
    shard = opened(path)
    shard.check()
    np.testing.assert_array_equal(shard.read(1, "later", slice(0, 1)), [2.0, 3.0])
    shard.packed(0)


def test_a_foreign_hdf5_file_is_refused(path):
    with h5py.File(path, "w") as file:
        file["rgb"] = np.zeros((2, 2))
    with pytest.raises(UsageError, match="not one of obpose-datagen"):
        opened(path)


def test_a_file_of_a_newer_format_is_refused(path):
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = schema.FORMAT_VERSION + 1
    with pytest.raises(UsageError, match="format version 2"):
        opened(path)


def test_a_missing_file_is_an_incomplete_dataset(tmp_path):
    with pytest.raises(DatagenError, match="incomplete"):
        Shard(tmp_path, SPEC, "train", 0)


def test_an_unknown_field_names_those_that_are_there(path):
    with pytest.raises(UsageError, match=r"no field 'flow'.*rgb"):
        opened(path).read(0, "flow")


def test_the_settings_of_a_file_are_known_without_its_dataset(path):
    assert shard_settings(path) == settings_hash(SPEC)
    (path.parent / "text.h5").write_text("text")
    with h5py.File(path.parent / "foreign.h5", "w") as file:
        file.attrs["settings_hash"] = "0" * 64
    for name in ("text.h5", "foreign.h5", "nothing.h5"):
        assert shard_settings(path.parent / name) is None


def test_scenes_are_counted_to_the_last_shard_and_every_shard_is_checked(path):
    facts = {**SPEC, "scenes_per_shard": 3}
    assert scenes_present(path.parent, facts, "val") == 0
    for number, scenes in ((0, 3), (4, 1)):
        write_shard(path.parent, facts, "train", number, [pack(record) for record in RECORDS[:scenes]])
    assert scenes_present(path.parent, facts, "train") == 13
    assert scenes_present(path.parent, facts, "train", first=5) == 0
    write_shard(path.parent, facts, "train", 2, [pack(RECORDS[0])], first_scene=9)
    with pytest.raises(UsageError, match=r"train-00002\.h5 holds scenes of train from scene 9"):
        scenes_present(path.parent, facts, "train")
