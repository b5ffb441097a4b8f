"""Other modes, sizes, formats and headers of images."""

import struct
import zlib
from pathlib import Path

from numpy.random import Generator
from PIL import Image

from tests.fuzz.mutations.draw import pick

_OWN = {".png": "PNG", ".tif": "TIFF", ".jpg": "JPEG", ".webp": "WEBP"}


def other_mode(path: Path, rng: Generator) -> str:
    """Store the picture in another mode or size; the file is sound."""
    with Image.open(path) as image:
        image.load()
        modes = ("1", "L", "P", "RGB", "RGBA", "LA", "CMYK", "I", "I;16", "F")
        mode, size = pick(rng, (image.mode, *modes)), pick(rng, (image.size, image.size, (1, 1), (5, 3), (64, 200)))
        kind = _OWN[path.suffix]
        try:
            plain = image if mode == image.mode else image.convert("L").convert(mode)
            plain.resize(size).save(path, kind)
        except (ValueError, OSError, KeyError):
            image.convert("L").resize(size).save(path, kind)
    return f"{mode} {size}"


def other_format(path: Path, rng: Generator) -> str:
    """A picture of another format under the same name, or one of several frames, or one that is turned."""
    kind = pick(rng, ("GIF", "BMP", "WEBP", "PPM", "TIFF", "several", "turned"))
    with Image.open(path) as opened:
        image = opened.convert("RGB")
    if kind == "several":
        own = "MPO" if path.suffix == ".jpg" else _OWN[path.suffix]
        image.save(path, own, save_all=True, append_images=[image.transpose(Image.Transpose.ROTATE_180)] * 3)
    elif kind == "turned":
        exif = Image.Exif()
        exif[0x0112] = int(rng.integers(10))
        image.save(path, "PNG" if path.suffix == ".png" else "JPEG", exif=exif)
    else:
        image.save(path, kind)
    return kind


def huge_picture(path: Path, rng: Generator) -> str:
    """A picture whose header names another size; the checksum of a PNG fits."""
    side, data = pick(rng, (0, 6_000, 13_000, 60_000)), bytearray(path.read_bytes())
    if path.suffix == ".png":
        data[16:24] = struct.pack(">II", side, side)
        data[29:33] = struct.pack(">I", zlib.crc32(bytes(data[12:29])))
    elif path.suffix == ".jpg":
        frame = data.index(b"\xff\xc0")
        data[frame + 5 : frame + 9] = struct.pack(">HH", side, side)
    elif path.suffix == ".webp":
        struct.pack_into("<HH", data, 26, side % 2**14, side % 2**14)
    else:
        (table,) = struct.unpack_from("<I", data, 4)
        (count,) = struct.unpack_from("<H", data, table)
        for entry in range(table + 2, table + 2 + 12 * count, 12):
            if struct.unpack_from("<H", data, entry)[0] in (256, 257):  # width and height
                struct.pack_into("<HII", data, entry + 2, 4, 1, side)
    path.write_bytes(data)
    return f"{side} x {side}"
