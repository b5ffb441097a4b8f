"""Colour and depth images of a recording, in common file formats.

Sizes and modes are checked from the file headers, before any pixel is decoded.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from datagen.errors import UsageError
from datagen.rgbd.arrays import array_header, is_array, read_array
from datagen.storage.safe_io import open_image

Size = tuple[int, int]
"""Width and height in pixels."""

_COLOUR_MODES = ("RGB", "RGBA", "L", "LA", "P", "PA", "YCbCr")
"""Pillow modes with an unambiguous conversion to RGB."""
_UPRIGHT = (None, 0, 1)
"""EXIF orientations of images that are stored upright; 0 means unknown."""
_ORIENTATION, _SAMPLE_FORMAT, _BITS = 0x0112, 339, 258
"""EXIF and TIFF tags."""
_SIGNED = 2
"""TIFF sample format of signed integers."""


def colour_size(path: Path) -> Size:
    """Read the size of a colour image from its header.

    Raises:
        UsageError: it is no upright 8-bit or 16-bit colour image with one page.
        CorruptFile: it is damaged, of another format, or too large.
    """
    if is_array(path):
        shape, dtype = array_header(path)
        if len(shape) != 3 or shape[2] != 3 or dtype != np.uint8:
            raise UsageError(
                f"{path} holds no colours: shape {shape}, type {dtype}; expected height, width, 3 of uint8."
            )
        return shape[1], shape[0]
    with open_image(path) as image:
        if _is_depth(image):
            raise UsageError(f"{path} is no colour image (mode {image.mode}); are colour and depth swapped?")
        if image.mode not in _COLOUR_MODES:
            raise UsageError(f"{path} has mode {image.mode}; expected RGB colours. Convert it to an RGB PNG.")
        _check_header(image, path)
        return image.size


def depth_size(path: Path) -> Size:
    """Read the size of a depth image or array from its header.

    Raises:
        UsageError: it is no upright image with one page and one channel of 16 bits or floats, or no 2D number array.
        CorruptFile: it is damaged, of another format, or too large.
    """
    if is_array(path):
        shape, dtype = array_header(path)
        shape = shape[:2] if len(shape) == 3 and shape[2] == 1 else shape
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
    """Read a colour image as sRGB; raises as `colour_size`, and UsageError if parts of it are transparent."""
    if is_array(path):
        return read_array(path)
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
    """Read a depth image or array in metres, with 0 for missing depth; raises as `depth_size`.

    Values that are negative or not finite are missing. So is the largest value of the stored type (65535 in 16 bits),
    which sensors write for surfaces that are too far.

    `scale` is in metres per unit of integers; floats are metres.
    """
    values, stored = _read_values(path)
    is_integer = values.dtype.kind in "ui"
    with np.errstate(over="ignore", invalid="ignore"):
        metres = values.astype(np.float32) * np.float32(scale if is_integer else 1)
    known = np.isfinite(metres) & (metres > 0)
    if is_integer:
        # Some programs store 16-bit values in a wider type.
        known &= (values != np.iinfo(stored).max) & (values != np.iinfo(np.uint16).max)
    return np.where(known, metres, np.float32(0))


def holds_floats(path: Path) -> bool:
    """Whether a depth image or array holds floats; raises as `depth_size`."""
    if is_array(path):
        return array_header(path)[1].kind == "f"
    with open_image(path) as image:
        return image.mode.startswith("F")


def _is_depth(image: Image.Image) -> bool:
    return image.mode.startswith(("I", "F"))


def _read_values(path: Path) -> tuple[np.ndarray, np.dtype]:
    """Read values and their stored type; Pillow widens signed 16-bit integers."""
    if is_array(path):
        values = read_array(path)
        return (values[..., 0] if values.ndim == 3 else values), values.dtype
    with open_image(path) as image:
        tags = getattr(image, "tag_v2", {})
        signed = tags.get(_BITS) == (16,) and tags.get(_SAMPLE_FORMAT) == (_SIGNED,)
        image.load()
        _check_orientation(image, path)
        values = np.asarray(image)
    return values, np.dtype(np.int16) if signed else values.dtype


def _check_header(image: Image.Image, path: Path) -> None:
    """Check for several pages and for rotation, as far as the header tells."""
    # MPO files are JPEG files with previews behind the photograph.
    if getattr(image, "is_animated", False) and image.format != "MPO":
        raise UsageError(f"{path} holds several images; expected one in each file. Save its pages as single files.")
    # In PNG files the orientation may follow the pixels. Pillow rotates TIFF images when it decodes them.
    if image.format != "PNG":
        _check_orientation(image, path)


def _check_orientation(image: Image.Image, path: Path) -> None:
    """Refuse a rotated image, because depth and intrinsics may not be rotated with it."""
    orientation = image.getexif().get(_ORIENTATION)
    if orientation not in _UPRIGHT:
        raise UsageError(
            f"{path} is rotated or mirrored (EXIF orientation {orientation}); expected pixels that are stored like "
            "those of the depth image and as the intrinsics describe. Rotate the pixels and remove the orientation."
        )
