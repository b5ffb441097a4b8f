import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datagen.errors import CorruptFile, UsageError
from datagen.rgbd.files import read_ids
from datagen.rgbd.images import colour_size, depth_size, read_colour, read_depth

SIZE = (6, 4)
RGB = (200, 100, 50)


def save(folder: Path, name: str, image: Image.Image | np.ndarray, **options: object) -> Path:
    image = Image.fromarray(image) if isinstance(image, np.ndarray) else image
    image.save(folder / name, **options)  # pyright: ignore[reportArgumentType]
    return folder / name


def png(width: int, height: int, bits: int, kind: int, data: bytes = b"") -> bytes:
    """Make a PNG file; without data its pixels are missing."""
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0)), (b"IDAT", zlib.compress(data))]
    parts = (
        struct.pack(">I", len(body)) + tag + body + struct.pack(">I", zlib.crc32(tag + body)) for tag, body in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def turned(orientation: int) -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112] = orientation
    return exif


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
@pytest.mark.parametrize("alpha", [255, 0])
def test_a_uniform_alpha_channel_is_ignored(tmp_path: Path, name: str, alpha: int):
    path = save(tmp_path, name, Image.new("RGBA", SIZE, (*RGB, alpha)))
    assert colour_size(path) == SIZE
    assert (read_colour(path) == RGB).all()


def test_other_colour_modes_are_read(tmp_path: Path):
    plain = Image.new("RGB", SIZE, RGB)
    assert (read_colour(save(tmp_path, "p.png", plain.quantize(8))) == RGB).all()
    assert (read_colour(save(tmp_path, "l.png", Image.new("L", SIZE, 77))) == 77).all()
    assert (read_colour(save(tmp_path, "la.png", Image.new("LA", SIZE, (77, 255)))) == 77).all()
    row = b"\0" + np.tile(np.array([51200, 25600, 12800], ">u2"), SIZE[0]).tobytes()
    (tmp_path / "16.png").write_bytes(png(*SIZE, 16, 2, SIZE[1] * row))
    assert (read_colour(tmp_path / "16.png") == RGB).all()


def half_transparent(mode: str) -> Image.Image:
    values = np.full((*SIZE[::-1], 4), 255, np.uint8)
    values[:2, :, 3] = 0
    image = Image.fromarray(values)
    return image if mode == "RGBA" else image.convert(mode)


@pytest.mark.parametrize("mode", ["RGBA", "LA", "PA"])
def test_partly_transparent_images_are_refused(tmp_path: Path, mode: str):
    path = save(tmp_path, "a.tif" if mode == "PA" else "a.png", half_transparent(mode))
    with pytest.raises(UsageError, match=r"a\.(png|tif) has transparent parts"):
        read_colour(path)


def test_a_transparent_palette_entry_is_refused(tmp_path: Path):
    values = np.zeros(SIZE[::-1], np.uint8)
    values[:2] = 1
    image = Image.fromarray(values)
    image.putpalette([0, 0, 0, 255, 255, 255])
    with pytest.raises(UsageError, match="transparent parts"):
        read_colour(save(tmp_path, "a.png", image, transparency=b"\x00\xff"))


@pytest.mark.parametrize(
    ("name", "image", "said"),
    [
        ("a.jpg", Image.new("CMYK", SIZE), "mode CMYK; expected RGB"),
        ("a.tif", Image.new("LAB", SIZE), "mode LAB; expected RGB"),
        ("a.png", Image.new("1", SIZE), "mode 1; expected RGB"),
        ("a.png", Image.fromarray(np.ones(SIZE[::-1], np.uint16)), "no colour image.*colour and depth swapped"),
        ("a.tif", Image.new("F", SIZE), "no colour image"),
    ],
)
def test_other_modes_are_no_colour_images(tmp_path: Path, name: str, image: Image.Image, said: str):
    with pytest.raises(UsageError, match=said):
        colour_size(save(tmp_path, name, image))


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
@pytest.mark.parametrize("orientation", [2, 3, 6, 8])
def test_rotated_images_are_refused(tmp_path: Path, name: str, orientation: int):
    path = save(tmp_path, name, Image.new("RGB", SIZE, RGB), exif=turned(orientation))
    with pytest.raises(UsageError, match=rf"rotated or mirrored \(EXIF orientation {orientation}\)"):
        _ = colour_size(path), read_colour(path)


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
def test_rotated_depth_is_refused(tmp_path: Path, name: str):
    path = save(tmp_path, name, np.full(SIZE[::-1], 1000, np.uint16), exif=turned(6))
    with pytest.raises(UsageError, match="EXIF orientation 6"):
        _ = depth_size(path), read_depth(path, 0.001)


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
def test_upright_images_are_read(tmp_path: Path, name: str):
    for exif in (turned(1), Image.Exif()):
        path = save(tmp_path, name, Image.new("RGB", SIZE, RGB), exif=exif)
        assert colour_size(path) == SIZE
        assert read_colour(path).shape == (*SIZE[::-1], 3)


@pytest.mark.parametrize("name", ["a.tif", "a.png"])
def test_several_images_in_a_file_are_refused(tmp_path: Path, name: str):
    pages = [Image.fromarray(np.full(SIZE[::-1], value, np.uint16)) for value in (1000, 2000)]
    with pytest.raises(UsageError, match="holds several images; expected one in each file"):
        depth_size(save(tmp_path, name, pages[0], save_all=True, append_images=pages[1:]))


@pytest.mark.parametrize("order", ["<", ">"])
def test_both_byte_orders_are_read(tmp_path: Path, order: str):
    data = np.full(SIZE[::-1], 1500, f"{order}u2")
    tiff(tmp_path / "a.tif", data)
    np.save(tmp_path / "a.npy", data)
    for name in ("a.tif", "a.npy"):
        assert depth_size(tmp_path / name) == SIZE
        np.testing.assert_allclose(read_depth(tmp_path / name, 0.001), 1.5)


def tiff(path: Path, values: np.ndarray) -> None:
    """Write an uncompressed TIFF with one channel, in the byte order of the values."""
    order = values.dtype.str[0]
    order = order if order in "<>" else "<"
    height, width = values.shape
    kind = {"u": 1, "i": 2, "f": 3}[values.dtype.kind]
    tags = [(256, 3, width), (257, 3, height), (258, 3, 8 * values.itemsize), (259, 3, 1), (262, 3, 1)]
    tags += [(273, 4, 8), (277, 3, 1), (278, 3, height), (279, 4, values.nbytes), (339, 3, kind)]
    entries = b"".join(
        struct.pack(f"{order}HHI", tag, form, 1) + struct.pack(f"{order}{'I' if form == 4 else 'Hxx'}", value)
        for tag, form, value in tags
    )
    head = struct.pack(f"{order}2sHI", b"II" if order == "<" else b"MM", 42, 8 + values.nbytes)
    directory = struct.pack(f"{order}H", len(tags)) + entries + struct.pack(f"{order}I", 0)
    path.write_bytes(head + values.tobytes() + directory)


STORED = [("u2", 65535), ("i2", 32767), ("i4", 2**31 - 1), ("u4", 2**32 - 1), ("i4", 65535)]


@pytest.mark.parametrize(
    ("ending", "dtype", "largest"),
    [*((".tif", *each) for each in STORED), *((".npy", *each) for each in [*STORED, ("u1", 255), ("i8", 65535)])],
)
def test_the_largest_value_of_the_type_is_missing_depth(tmp_path: Path, ending: str, dtype: str, largest: int):
    values = np.full(SIZE[::-1], 100, dtype)
    values[0, :2] = largest, largest - 1
    path = tmp_path / f"a{ending}"
    np.save(path, values) if ending == ".npy" else tiff(path, values)
    found = read_depth(path, 1.0)
    assert found[0, 0] == 0
    assert (found[1:] == 100).all()
    if (ending, dtype) != (".tif", "u4"):  # Pillow reads these as numbers with a sign
        assert found[0, 1] == pytest.approx(largest - 1)


def test_the_largest_value_of_a_png_is_missing_depth(tmp_path: Path):
    values = np.array([[65535, 65534, 32767, 0]], np.uint16)
    np.testing.assert_allclose(read_depth(save(tmp_path, "a.png", values), 0.001), [[0, 65.534, 32.767, 0]])


def test_invalid_floats_are_missing_depth(tmp_path: Path):
    values = np.array([[np.nan, np.inf, -np.inf, -1, 1e300, 1.5]])
    np.save(tmp_path / "a.npy", values)
    np.testing.assert_array_equal(read_depth(tmp_path / "a.npy", 0.001), [[0, 0, 0, 0, 0, 1.5]])


@pytest.mark.parametrize(
    ("name", "image", "said"),
    [
        ("a.png", Image.new("RGB", SIZE), "mode RGB; expected one channel of 16 bits or of floats"),
        ("a.png", Image.new("L", SIZE), "mode L"),
        ("a.png", Image.new("P", SIZE), "mode P"),
        ("a.jpg", Image.new("L", SIZE), "mode L"),
        ("a.tif", Image.new("RGBA", SIZE), "mode RGBA"),
    ],
)
def test_other_modes_are_no_depth_images(tmp_path: Path, name: str, image: Image.Image, said: str):
    with pytest.raises(UsageError, match=said):
        depth_size(save(tmp_path, name, image))


def test_arrays_may_have_an_axis_of_one_channel(tmp_path: Path):
    np.save(tmp_path / "a.npy", np.arange(6.0).reshape(2, 3, 1))
    assert depth_size(tmp_path / "a.npy") == (3, 2)
    np.testing.assert_array_equal(read_depth(tmp_path / "a.npy", 1.0), np.arange(6.0).reshape(2, 3))


@pytest.mark.parametrize("values", [np.ones((2, 3, 2)), np.ones(3), np.ones((2, 3), bool), np.ones((2, 3), complex)])
def test_other_arrays_are_no_depth(tmp_path: Path, values: np.ndarray):
    np.save(tmp_path / "a.npy", values)
    with pytest.raises(UsageError, match=r"holds no depth: it has shape .* and type"):
        depth_size(tmp_path / "a.npy")


def test_sizes_come_from_the_headers(tmp_path: Path):
    (tmp_path / "rgb.png").write_bytes(png(5000, 4000, 8, 2))
    (tmp_path / "depth.png").write_bytes(png(5000, 4000, 16, 0))
    with (tmp_path / "depth.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": (4000, 5000)})
    assert colour_size(tmp_path / "rgb.png") == (5000, 4000)
    assert depth_size(tmp_path / "depth.png") == depth_size(tmp_path / "depth.npy") == (5000, 4000)
    for read, name in ((read_colour, "rgb.png"), (lambda path: read_depth(path, 1.0), "depth.npy")):
        with pytest.raises(CorruptFile):
            read(tmp_path / name)


def test_too_large_images_are_refused_by_their_headers(tmp_path: Path):
    (tmp_path / "rgb.png").write_bytes(png(12_000, 12_000, 8, 2))
    with pytest.raises(CorruptFile, match=r"12000 x 12000 pixels; expected at most 40,000,000"):
        colour_size(tmp_path / "rgb.png")


def test_damaged_metadata_cause_no_warning(tmp_path: Path):
    path = save(tmp_path, "a.jpg", Image.new("RGB", SIZE, RGB), exif=b"Exif\0\0II*\0\x08\0\0\0\x01\0")
    assert colour_size(path) == SIZE
    assert read_colour(path).shape == (*SIZE[::-1], 3)


@pytest.mark.parametrize("wrong", [-3, 2**63 - 1])
def test_an_id_out_of_range_is_named(tmp_path: Path, wrong: int):
    np.save(tmp_path / "a.npy", np.array([[0, 7], [7, wrong]]))
    with pytest.raises(UsageError, match=f"has the id {wrong}; expected 0 for the background and ids up to 4,611,"):
        read_ids(tmp_path / "a.npy")
