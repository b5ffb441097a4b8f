"""Single images of a recording: colour and depth in the usual file formats.

Sizes and kinds are checked from the files' headers, before any pixel is decoded.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from datagen.storage.safe_io import npy_shape, open_image, read_npy
from obpose.errors import UsageError

Size = tuple[int, int]
"""Width and height in pixels."""

_COLOUR_MODES = ("RGB", "RGBA", "L", "LA", "P", "PA", "YCbCr")
"""Pillow's names of what becomes RGB without guesses."""
_UPRIGHT = (None, 0, 1)
"""EXIF orientations of images whose pixels lie as they are shown; 0 stands for unknown."""
_ORIENTATION, _SAMPLE_FORMAT, _BITS = 0x0112, 339, 258
"""EXIF and TIFF tags."""
_SIGNED = 2
"""TIFF sample format of whole numbers with a sign."""


def colour_size(path: Path) -> Size:
    """Size of a colour image from its header.

    Raises:
        UsageError: it is no upright 8-bit or 16-bit colour image of one page.
        CorruptFile: it is damaged, of another format, or too large.
    """
    with open_image(path) as image:
        if _is_depth(image):
            raise UsageError(f"{path} is no colour image (mode {image.mode}); are --rgb and --depth swapped?")
        if image.mode not in _COLOUR_MODES:
            raise UsageError(f"{path} has mode {image.mode}; expected RGB colours. Convert it to an RGB PNG.")
        _check_header(image, path)
        return image.size


def depth_size(path: Path) -> Size:
    """Size of a depth image or NPY array from its header.

    Raises:
        UsageError: it is no upright image of one page and one channel of 16 bits or floats, or no 2D array of numbers.
        CorruptFile: it is damaged, of another format, or too large.
    """
    if _is_array(path):
        shape, dtype = npy_shape(path)
        if len(shape) != 2 or dtype.kind not in "uif":
            raise UsageError(
                f"{path} holds no depth: it has shape {shape} and type {dtype}; expected an array of numbers with "
                "height and width."
            )
        return shape[1], shape[0]
    with open_image(path) as image:
        if not _is_depth(image):
            raise UsageError(
                f"{path} holds no depth: it has mode {image.mode}; expected one channel of 16 bits or of floats."
            )
        _check_header(image, path)
        return image.size


def read_colour(path: Path) -> UInt8[np.ndarray, "height width 3"]:
    """Read a colour image as sRGB; raises as `colour_size`, and UsageError where parts of it are transparent."""
    with open_image(path) as image:
        image.load()
        _check_orientation(image, path)
        if image.mode not in ("RGBA", "LA", "PA") and "transparency" not in image.info:
            return np.asarray(image.convert("RGB"))
        pixels = np.asarray(image.convert("RGBA"))
        if pixels[..., 3].min() != pixels[..., 3].max():
            raise UsageError(
                f"{path} has transparent parts, whose colours are unknown; expected opaque pixels. Save it without "
                "transparency."
            )
        return pixels[..., :3]


def read_depth(path: Path, scale: float) -> Float32[np.ndarray, "height width"]:
    """Read a depth image or array in metres, 0 where there is no return; raises as `depth_size`.

    Not finite and negative values are no returns. Neither is the largest value of the stored type, which sensors write
    for what is too far: 65535 in 16 bits.

    Args:
        path: PNG, TIFF or NPY.
        scale: Metres of one unit of whole numbers; floats are metres.
    """
    values, stored = _read_array(path) if _is_array(path) else _read_image(path)
    whole = values.dtype.kind in "ui"
    with np.errstate(over="ignore", invalid="ignore"):
        metres = values.astype(np.float32) * np.float32(scale if whole else 1)
    seen = np.isfinite(metres) & (metres > 0)
    if whole:
        # Some programs keep numbers of 16 bits in a wider type.
        seen &= (values != np.iinfo(stored).max) & (values != np.iinfo(np.uint16).max)
    return np.where(seen, metres, np.float32(0))


def _is_array(path: Path) -> bool:
    return path.suffix.lower() == ".npy"


def _is_depth(image: Image.Image) -> bool:
    return image.mode.startswith(("I", "F"))


def _read_array(path: Path) -> tuple[np.ndarray, np.dtype]:
    """Read values and the type in which they are stored."""
    values = read_npy(path)
    return values, values.dtype


def _read_image(path: Path) -> tuple[np.ndarray, np.dtype]:
    """Read values and the type in which they are stored; Pillow widens whole numbers of 16 bits with a sign."""
    with open_image(path) as image:
        tags = getattr(image, "tag_v2", {})
        signed = tags.get(_BITS) == (16,) and tags.get(_SAMPLE_FORMAT) == (_SIGNED,)
        image.load()
        _check_orientation(image, path)
        values = np.asarray(image)
    return values, np.dtype(np.int16) if signed else values.dtype


def _check_header(image: Image.Image, path: Path) -> None:
    """Check what is known before pixels are decoded."""
    # Photographs in MPO files, a kind of JPEG, come before previews of them.
    if getattr(image, "is_animated", False) and image.format != "MPO":
        raise UsageError(f"{path} holds several images; expected one in each file. Save its pages as single files.")
    # In PNG files orientations may come after the pixels. Pillow turns those of TIFF files when it decodes them.
    if image.format != "PNG":
        _check_orientation(image, path)


def _check_orientation(image: Image.Image, path: Path) -> None:
    """Refuse an image that is stored turned: whether depth and intrinsics are turned with it is unknown."""
    orientation = image.getexif().get(_ORIENTATION)
    if orientation not in _UPRIGHT:
        raise UsageError(
            f"{path} is to be shown turned or mirrored (EXIF orientation {orientation}); expected pixels that lie as "
            "those of the depth image and as --intrinsics describe. Save it turned as they are, without the "
            "orientation."
        )
