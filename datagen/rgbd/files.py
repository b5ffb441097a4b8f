"""Images, masks and intrinsics in files of other projects, with checks of their units."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64, UInt8

from datagen.errors import CorruptFile, UsageError
from datagen.rgbd.arrays import archive_of, array_header, is_array, read_array
from datagen.rgbd.images import Size, colour_size, depth_size, read_depth
from datagen.storage.safe_io import open_image, read_json

PLAUSIBLE_DEPTH = (0.05, 6.5)
"""Range of the median depth in metres; other medians indicate a wrong unit, or a scene too large for the format."""
PLAUSIBLE_FOCAL = (0.1, 50.0)
"""Range of focal lengths, relative to the longer side of the image."""
_USUAL_DEPTH = (0.2, 4.0)
_USUAL_UNITS = (0.001, 0.0001, 0.0002, 0.00025, 1.0)
"""Units of depth images, metres, from the most common one on."""
_MOST_ID = 2**62 - 1
_MASK_MODES = ("L", "P", "I", "I;16", "I;16B", "1")
HALF_PIXEL = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
"""From OpenCV's camera matrices, where the first pixel's centre is at (0, 0), to ours, where it is at (0.5, 0.5)."""


def read_opaque(path: Path) -> UInt8[np.ndarray, "height width 3"]:
    """Read a colour image and ignore its alpha channel.

    Raises:
        UsageError: there is no such file.
        CorruptFile: it is damaged.
    """
    with _opening(path) as image:
        return np.asarray(image.convert("RGB"))


def read_ids(path: Path) -> Int64[np.ndarray, "height width"]:
    """Read a mask of object ids: one channel of 8 or 16 bits, or palette indices.

    Raises:
        UsageError: there is no such file, or it has several channels.
        CorruptFile: it is damaged.
    """
    if is_array(path):
        mask_size(path)
        return _checked_ids(read_array(path), path)
    with _opening(path) as image:
        if image.mode not in _MASK_MODES:
            raise UsageError(
                f"{path} is no mask: it has mode {image.mode}; expected one channel with an object's id in each pixel, "
                "0 = background. Convert it, or leave masks out with --ignore-masks."
            )
        return _checked_ids(np.asarray(image), path)


def _checked_ids(values: np.ndarray, path: Path) -> Int64[np.ndarray, "height width"]:
    low, high = int(values.min()), int(values.max())
    if low < 0 or high > _MOST_ID:
        wrong = low if low < 0 else high
        raise UsageError(f"{path} has the id {wrong}; expected 0 for the background and ids up to {_MOST_ID:,}.")
    return values.astype(np.int64)


def mask_size(path: Path) -> Size:
    """Read the size of a mask from its header; raises as `read_ids`."""
    if is_array(path):
        shape, dtype = array_header(path)
        if len(shape) != 2 or dtype.kind not in "biu":
            raise UsageError(f"{path} is no mask: shape {shape}, type {dtype}; expected integers, height and width.")
        return shape[1], shape[0]
    with _opening(path) as image:
        return image.size


def _opening(path: Path) -> Any:
    if not path.exists():
        raise missing_file(path)
    return open_image(path)


def missing_file(path: Path) -> UsageError:
    """Error about a file that the format requires."""
    return UsageError(f"{path} is missing; the source is incomplete. Complete it, or remove the rest of its scene.")


def common_size(colours: Sequence[Path], depths: Sequence[Path], masks: Sequence[Path] = ()) -> Size:
    """Check by their headers that all images of a recording have one size.

    Raises:
        UsageError: a file is missing, or images differ in size.
        CorruptFile: a file is damaged.
    """
    for path in (*colours, *depths, *masks):
        if not (archive_of(path) or path).exists():
            raise missing_file(path)
    size = colour_size(colours[0])
    for paths, size_of in ((colours, colour_size), (depths, depth_size), (masks, mask_size)):
        for path in paths:
            if (found := size_of(path)) != size:
                raise UsageError(
                    f"{path} is {found[0]}x{found[1]}, but {colours[0]} is {size[0]}x{size[1]}; expected one size in a "
                    "recording, with depth and masks aligned to colour. Resize or align them first."
                )
    return size


def planar_depth(
    distance: Float[np.ndarray, "height width"], k: Float[np.ndarray, "3 3"]
) -> Float32[np.ndarray, "h w"]:
    """Convert Euclidean distances along the rays of all pixels to planar depth."""
    height, width = distance.shape
    x = (np.arange(width) + 0.5 - k[0, 2]) / k[0, 0]
    y = (np.arange(height) + 0.5 - k[1, 2]) / k[1, 1]
    return (distance / np.sqrt(1 + x[None] ** 2 + y[:, None] ** 2)).astype(np.float32)


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Float64[np.ndarray, "3 3"]:
    """Camera matrix from focal lengths and principal point, pixels."""
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def check_intrinsics(k: Float64[np.ndarray, "3 3"], size: Size, place: str) -> None:
    """Check that a camera matrix can be that of images of a size.

    Raises:
        UsageError: it cannot; `place` names its file.
    """
    if not np.array_equal(k[[1, 2, 2, 2], [0, 0, 1, 2]], [0, 0, 0, 1]):
        raise UsageError(
            f"{place} holds no camera matrix: its rows are {k.tolist()}; expected fx 0 cx, 0 fy cy, 0 0 1. Transpose "
            "it if it is stored by columns."
        )
    (width, height), (low, high) = size, PLAUSIBLE_FOCAL
    fx, fy, cx, cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    plausible = np.isfinite(k).all() and all(low < focal / max(width, height) < high for focal in (fx, fy))
    if not plausible or not (-width < cx < 2 * width and -height < cy < 2 * height):
        raise UsageError(
            f"{place}: fx, fy, cx, cy = {fx:g}, {fy:g}, {cx:g}, {cy:g} cannot be those of images of {width}x{height}; "
            "expected pixels of these images. If the images were resized, scale all four alike."
        )


def read_metres(path: Path, scale: float) -> Float32[np.ndarray, "height width"]:
    """Read a depth image of `scale` metres per unit; raises as `datagen.rgbd.images.read_depth` and `check_unit`."""
    depth = read_depth(path, scale)
    check_unit(depth, scale, str(path))
    return depth


def check_unit(depth: Float32[np.ndarray, "..."], scale: float, place: str) -> None:
    """Check the unit of depths in metres, which were read with `scale` metres per unit.

    Raises:
        UsageError: there are none, or their median is implausible; suggests another unit.
    """
    known = depth[depth > 0]
    if not len(known):
        raise UsageError(f"{place} has no depth: all pixels hold 0, or the largest value of their type. Remove it.")
    median, (low, high) = float(np.median(known)), PLAUSIBLE_DEPTH
    if low < median < high:
        return
    others = [unit for unit in _USUAL_UNITS if _USUAL_DEPTH[0] < median / scale * unit < _USUAL_DEPTH[1]]
    hint = f" With --depth-scale {others[0]:g} it would be {median / scale * others[0]:.2g} m." if others else ""
    raise UsageError(
        f"{place}: the median depth is {median:.3g} m at {scale:g} m per unit; expected {low:g} to {high:g} m. Give "
        f"the metres per unit with --depth-scale.{hint}"
    )


def read_object(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        UsageError: there is no such file.
        CorruptFile: it is damaged, or holds something else.
    """
    try:
        values = read_json(path, most_bytes=256 * 2**20)
    except FileNotFoundError:
        raise missing_file(path) from None
    if not isinstance(values, dict):
        raise CorruptFile(f"{path} is damaged: it holds {values!r:.20}, expected an object.")
    return values


def numbers(values: Any, count: int, place: str) -> Float64[np.ndarray, " count"]:
    """Convert a list of `count` numbers, nested or not.

    Raises:
        CorruptFile: it is something else; `place` names it.
    """
    flat = (
        [item for row in values for item in (row if isinstance(row, list) else [row])] if type(values) is list else []
    )
    if len(flat) != count or not all(type(item) in (int, float) and abs(item) < 1e300 for item in flat):
        raise CorruptFile(f"{place} is {values!r:.60}; expected {count} numbers.")
    return np.array(flat, np.float64)
