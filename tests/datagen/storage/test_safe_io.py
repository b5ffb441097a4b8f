import json
import os
import struct
import zipfile
import zlib

import h5py
import numpy as np
import pytest
from h5py import h5d, h5p, h5s, h5t, h5z
from PIL import Image

from datagen.errors import CorruptFile, UsageError
from datagen.storage import safe_io
from datagen.storage.safe_io import (
    LZ4_FILTER,
    hdf5_attribute,
    hdf5_dataset,
    npy_shape,
    open_hdf5,
    open_hdf5_by_name,
    open_image,
    parse_json,
    read_bytes,
    read_hdf5,
    read_json,
    read_npy,
    read_npz,
    read_text,
)


def image_size(path) -> tuple[int, int]:
    with open_image(path) as image:
        return image.size


READERS = (read_bytes, read_text, read_json, read_npy, npy_shape, image_size)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("read", [*READERS, lambda path: read_npz(path, ["a"])])
def test_a_pipe_is_refused_and_never_opened(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UsageError, match="pipe, a device or a socket"):
        read(tmp_path / "pipe")
    with pytest.raises(UsageError, match="is a folder"):
        read(tmp_path)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "nothing")


def test_size_is_checked_before_reading(tmp_path):
    (tmp_path / "a").write_bytes(bytes(11))
    assert read_bytes(tmp_path / "a", 11) == bytes(11)
    with pytest.raises(CorruptFile, match="11 bytes; expected at most 10"):
        read_bytes(tmp_path / "a", 10)
    with open(tmp_path / "sparse", "wb") as file:
        file.truncate(2**40)
    for read in READERS:
        with pytest.raises(CorruptFile):
            read(tmp_path / "sparse")


@pytest.mark.parametrize(
    "text", ["NaN", "-Infinity", "[1e999]", "[" * 100_000, "[" * 65 + "]" * 65, "9" * 5000, "", "{"]
)
def test_json_has_finite_numbers_and_limited_nesting(tmp_path, text):
    with pytest.raises(ValueError, match=r"."):
        parse_json(text)
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(CorruptFile, match=r"a\.json is damaged"):
        read_json(tmp_path / "a.json")


def test_wide_json_is_refused_by_its_size(tmp_path):
    (tmp_path / "a.json").write_text("[" + "[]," * 3_000_000 + "[]]")
    with pytest.raises(CorruptFile, match="expected at most 8,388,608"):
        read_json(tmp_path / "a.json")


def test_json_reads_what_json_wrote():
    value = {"a": [1, 2.5, None, True, {"b": "text"}], "deep": [[[[]]]]}
    assert parse_json(json.dumps(value)) == value
    assert parse_json("[" * 64 + "]" * 64)


def test_text_must_be_utf_8(tmp_path):
    (tmp_path / "a").write_bytes(b"abc\xff")
    with pytest.raises(CorruptFile, match="byte 3 is not UTF-8"):
        read_text(tmp_path / "a")


def _external_storage(file, folder):
    (folder / "secret").write_bytes(b"secret")
    file.create_dataset("x", (6,), np.uint8, external=[(str(folder / "secret"), 0, 6)])


def _external_link(file, folder):
    with h5py.File(folder / "other.h5", "w") as other:
        other["x"] = [1]
    file["x"] = h5py.ExternalLink(str(folder / "other.h5"), "/x")


def _virtual(file, folder):
    with h5py.File(folder / "other.h5", "w") as other:
        other["x"] = [1]
    layout = h5py.VirtualLayout((1,), int)
    layout[:] = h5py.VirtualSource(folder / "other.h5", "x", (1,))
    file.create_virtual_dataset("x", layout)


def _in_a_group(kind):
    def build(file, folder):
        kind(file.create_group("a/b"), folder)

    return build


def _soft_link(file, folder):
    file["x"] = h5py.SoftLink("/nowhere")


def _soft_loop(file, folder):
    file["x"] = h5py.SoftLink("/x")


def _hard_loop(file, folder):
    file["x"] = file


def _large_chunk(file, folder):
    size = safe_io.MOST_CHUNK_BYTES + 1
    file.create_dataset("x", (size,), np.uint8, chunks=(size,))


def _many_objects(file, folder):
    for number in range(safe_io.MOST_OBJECTS):
        file.create_group(f"g{number}")


OUTSIDE = (_external_storage, _external_link, _virtual, _soft_link, _soft_loop, _hard_loop)


@pytest.mark.parametrize("build", [*OUTSIDE, *(_in_a_group(kind) for kind in OUTSIDE), _large_chunk, _many_objects])
def test_hdf5_files_that_refer_elsewhere_or_are_too_large_are_refused(tmp_path, build):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        build(file, tmp_path)
    with (
        pytest.raises(CorruptFile, match=r"a\.h5 is truncated, damaged.*Mend it\."),
        open_hdf5(tmp_path / "a.h5", "Mend it."),
    ):
        pytest.fail("opened")


def test_hdf5_arrays_are_read_in_whole_or_in_part(tmp_path):
    values = np.arange(24).reshape(2, 3, 4)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["g/x"] = values
    with open_hdf5(tmp_path / "a.h5") as file:
        dataset = hdf5_dataset(file, "g/x", ndim=3, kinds="i")
        np.testing.assert_array_equal(read_hdf5(dataset), values)
        np.testing.assert_array_equal(read_hdf5(dataset, 1), values[1])
        np.testing.assert_array_equal(read_hdf5(dataset, (1, slice(0, 2))), values[1, :2])


def test_hdf5_parts_are_measured_before_they_are_read(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", (10**6, 1000), np.uint8, chunks=(1, 1000))
    with open_hdf5(tmp_path / "a.h5") as file:
        dataset = hdf5_dataset(file, "x")
        assert read_hdf5(dataset, 0).shape == (1000,)
        for selection in ((), slice(0, 540_000), slice(None), (slice(3, 900_000), slice(0, 600))):
            with pytest.raises(ValueError, match="bytes, more than 536,870,912"):
                read_hdf5(dataset, selection)


def test_hdf5_arrays_have_the_expected_type_and_axes(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["group/x"] = 1
        file["text"] = "variable length"
        file["numbers"] = [1.5]
        file["empty"] = h5py.Empty("f")
    with open_hdf5(tmp_path / "a.h5") as file:
        for name, options in (
            ("missing", {}),
            ("group", {}),
            ("text", {}),
            ("empty", {}),
            ("numbers", {"kinds": "iu"}),
            ("numbers", {"ndim": 2}),
            ("group/x", {"ndim": 1}),
        ):
            with pytest.raises(ValueError, match=f"{name} (is|has)"):
                hdf5_dataset(file, name, **options)


def test_errors_inside_an_open_hdf5_file_name_the_file(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = [1]
    with pytest.raises(CorruptFile, match=r"a\.h5"), open_hdf5(tmp_path / "a.h5") as file:
        file["y"]
    (tmp_path / "b.h5").write_bytes((tmp_path / "a.h5").read_bytes()[:100])
    with pytest.raises(CorruptFile, match=r"b\.h5"), open_hdf5(tmp_path / "b.h5"):
        pytest.fail("opened")


def test_a_file_that_h5py_holds_open_is_not_called_damaged(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["x"] = [1]
    with (
        h5py.File(tmp_path / "a.h5"),
        pytest.raises(UsageError, match=r"a\.h5 is already open in this process.*Close it"),
        open_hdf5(tmp_path / "a.h5"),
    ):
        pytest.fail("opened")
    with open_hdf5(tmp_path / "a.h5") as file:
        assert "x" in file


def _npy(header):
    text = header.encode() + b" " * (117 - len(header)) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(64)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x93NUMPY",
        _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 1000000000), }"),
        _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (9,), }"),
        _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }"),
        _npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"),
        _npy("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }"),
        _npy("{'descr': '<f8', 'shape': (1,), }"),
        _npy("[" * 100),
        _npy("{'descr': '<f8', 'fortran_order': False, 'shape': ('a',), }"),
        b"\x80\x04K\x01.",
    ],
)
def test_malformed_npy_files_are_refused(tmp_path, content):
    (tmp_path / "a.npy").write_bytes(content)
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("x.npy", content)
    with pytest.raises(CorruptFile, match=r"a\.npy is damaged"):
        read_npy(tmp_path / "a.npy")
    with pytest.raises(CorruptFile, match=r"a\.npz is damaged"):
        read_npz(tmp_path / "a.npz", ["x"])


def test_npy_and_npz_round_trip_and_are_measured_first(tmp_path):
    values = np.arange(12.0).reshape(3, 4)
    np.save(tmp_path / "a.npy", values)
    np.savez(tmp_path / "a.npz", x=values, other=values)
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy"), values)
    assert npy_shape(tmp_path / "a.npy") == ((3, 4), values.dtype)
    assert list(read_npz(tmp_path / "a.npz", ["x", "y"])) == ["x"]
    with pytest.raises(CorruptFile, match="96 bytes, more than 95"):
        read_npy(tmp_path / "a.npy", most_bytes=95)


def test_a_zip_bomb_is_not_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("x.npy", bytes(10**7))
    with pytest.raises(CorruptFile, match=r"x\.npy is larger than 1,000,000 bytes"):
        read_npz(tmp_path / "a.npz", ["x"], most_bytes=10**6)


def _png_header(width, height):
    """The start of a PNG whose pixels are missing."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    start = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))
    return start + struct.pack(">I", 10**6) + b"IDAT"


@pytest.mark.parametrize("size", [(40_000_001, 1), (50_000, 50_000), (2**31 - 1, 2**31 - 1)])
def test_large_images_are_refused_by_their_header(tmp_path, size):
    (tmp_path / "a.png").write_bytes(_png_header(*size))
    with pytest.raises(CorruptFile, match=r"a\.png has .* pixels"):
        image_size(tmp_path / "a.png")


def test_images_are_read_and_damage_is_reported(tmp_path):
    Image.fromarray(np.full((4, 6), 7, np.uint8)).save(tmp_path / "a.png")
    assert image_size(tmp_path / "a.png") == (6, 4)
    with open_image(tmp_path / "a.png") as image:
        assert np.all(np.asarray(image) == 7)
    (tmp_path / "b.png").write_bytes((tmp_path / "a.png").read_bytes()[:50])
    with pytest.raises(CorruptFile, match=r"b\.png is damaged"), open_image(tmp_path / "b.png") as image:
        image.load()
    (tmp_path / "c.png").write_text("no image")
    with pytest.raises(CorruptFile, match=r"c\.png is damaged or no image; expected PNG, JPEG, TIFF"):
        image_size(tmp_path / "c.png")
    Image.new("L", (2, 2)).save(tmp_path / "d.gif")
    with pytest.raises(CorruptFile, match="expected PNG, JPEG, TIFF"):
        image_size(tmp_path / "d.gif")


def test_infinity_is_a_number_only_where_it_is_allowed():
    assert parse_json('{"minutes": Infinity}', infinite=True) == {"minutes": float("inf")}
    for text in ("Infinity", "NaN", "-Infinity", "1e999"):
        with pytest.raises(ValueError, match="expected finite numbers"):
            parse_json(text, infinite=text not in ("Infinity",))


@pytest.mark.parametrize("open_file", [open_hdf5_by_name, safe_io.open_hdf5_file])
def test_arrays_that_are_reached_by_name_are_checked_when_they_are_used(tmp_path, open_file):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["g/x"] = np.arange(3)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["g/x"] = np.arange(3)
        file["x"] = np.arange(3)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["soft"] = h5py.SoftLink("/h/x")
        file["outside"] = h5py.ExternalLink("other.h5", "/g")
        file["h/x"] = np.arange(3)
        file["h/loop"] = file["h"]
        file.create_dataset("external", (3,), "i8", external=[("other.h5", 0, 24)])
        file.create_virtual_dataset("virtual", h5py.VirtualLayout((3,), "i8"))
    file = open_file(tmp_path / "a.h5")
    assert hdf5_dataset(file, "g/x").shape == (3,)
    with pytest.raises(ValueError, match="g/y is missing"):
        hdf5_dataset(file, "g/y")
    file.close()
    if open_file is safe_io.open_hdf5_file:
        with pytest.raises(CorruptFile):
            open_file(tmp_path / "b.h5")
        return
    file = open_file(tmp_path / "b.h5")
    for name, message in {
        "soft": "a link",
        "outside/x": "outside is a link",
        "external": "another file",
        "virtual": "a virtual dataset",
        "h": "a group",
    }.items():
        with pytest.raises(ValueError, match=message):
            hdf5_dataset(file, name)
    assert hdf5_dataset(file, "h/loop/loop/x").shape == (3,)
    file.close()


def test_attributes_are_one_text_or_one_number(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        right = {"text": "é", "bytes": np.bytes_(b"abc"), "whole": 3, "real": 0.5}
        wrong = {
            "list": [1, 2],
            "array": np.zeros((1,)),
            "texts": ["a", "b"],
            "empty": h5py.Empty("f"),
            "nan": np.nan,
            "infinite": np.inf,
            "invalid": b"\xff",
        }
        for name, value in {**right, **wrong}.items():
            file.attrs[name] = value
    with open_hdf5(tmp_path / "a.h5") as file:
        found = [hdf5_attribute(file, name, kind) for name, kind in zip(right, (str, str, int, float), strict=True)]
        assert found == ["é", "abc", 3, 0.5]
        for name in ("missing", *wrong):
            for kind in (str, int, float):
                with pytest.raises(ValueError, match=f"attribute {name} is"):
                    hdf5_attribute(file, name, kind)
        for name, kind in (("text", int), ("whole", str), ("whole", float), ("real", int)):
            with pytest.raises(ValueError, match=f"attribute {name} is not of type {kind.__name__}"):
                hdf5_attribute(file, name, kind)


@pytest.mark.parametrize("chunk", [zlib.compress(bytes(10**6)), bytes(10**6), zlib.compress(b"short"), b"damaged"])
@pytest.mark.parametrize("filters", [{}, {"shuffle": True}, {"fletcher32": True}])
def test_chunks_that_do_not_unpack_to_their_size_are_refused(tmp_path, chunk: bytes, filters: dict):
    # HDF5 reads memory behind a short chunk: noise, or a crash.
    values = np.random.default_rng(0).integers(0, 256, (3, 5000), np.uint8)
    with h5py.File(tmp_path / "a.h5", "w", libver="latest") as file:
        dataset = file.create_dataset("x", data=values, chunks=(1, 5000), compression="gzip", **filters)
        dataset.id.write_direct_chunk((1, 0), chunk)
    with open_hdf5(tmp_path / "a.h5") as file:
        dataset = hdf5_dataset(file, "x")
        for selection in (0, -1, (2, slice(1, 5)), slice(2, 3)):
            np.testing.assert_array_equal(read_hdf5(dataset, selection), values[selection])
        for selection in (1, -2, (1, slice(1, 5)), slice(0, 2), ()):
            with pytest.raises(ValueError, match="a chunk that does not unpack to its 5,000 bytes"):
                read_hdf5(dataset, selection)


@pytest.mark.parametrize("filters", [{"compression": "gzip"}, {"compression": "lzf"}, {"shuffle": True}])
def test_chunks_that_skip_the_filter_have_their_size(tmp_path, filters: dict):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        dataset = file.create_dataset("x", (2, 5000), np.uint8, chunks=(1, 5000), **filters)
        for row, size in enumerate((5000, 10)):
            dataset.id.write_direct_chunk((row, 0), bytes(size), filter_mask=0b1)
    with open_hdf5(tmp_path / "a.h5") as file:
        assert not read_hdf5(hdf5_dataset(file, "x"), 0).any()
        with pytest.raises(ValueError, match="a chunk that does not unpack to its 5,000 bytes"):
            read_hdf5(hdf5_dataset(file, "x"), 1)


@pytest.mark.parametrize(
    "filters", [{}, {"compression": "lzf", "shuffle": True}, {"scaleoffset": 0}, {"scaleoffset": 0, "compression": 4}]
)
def test_files_with_other_filters_are_read(tmp_path, filters: dict):
    values = np.random.default_rng(0).integers(0, 2**16, (3, 500), np.uint16)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("x", data=values, chunks=(2, 400), **filters)
    with open_hdf5(tmp_path / "a.h5") as file:
        np.testing.assert_array_equal(read_hdf5(hdf5_dataset(file, "x")), values)


@pytest.mark.parametrize("second", [h5z.FILTER_DEFLATE, LZ4_FILTER])
def test_arrays_that_are_packed_twice_are_refused(tmp_path, second: int):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        filters = h5p.create(h5p.DATASET_CREATE)
        filters.set_chunk((3,))
        filters.set_deflate(4)
        filters.set_filter(second, h5z.FLAG_OPTIONAL, (4,))
        h5d.create(file.id, b"x", h5t.NATIVE_UINT8, h5s.create_simple((3,)), filters)
    with pytest.raises(CorruptFile, match="x is packed twice"), open_hdf5(tmp_path / "a.h5"):
        pytest.fail("opened")
