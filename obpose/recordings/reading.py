"""Files of RGB-D frames, in the usual formats, as arrays."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from PIL import Image, UnidentifiedImageError

from obpose.errors import CorruptFile, UsageError

COLOUR_ENDINGS = (".png", ".jpg", ".jpeg")
DEPTH_ENDINGS = (".png", ".tif", ".tiff", ".npy")
PLAUSIBLE = (0.05, 50.0)
"""Metres between which the median depth of a recording must lie; others come of a wrong scale."""
FOCAL = (0.1, 50.0)
"""Larger sides of the image between which focal lengths must lie; others come of wrong units."""


@dataclass(frozen=True, eq=False)
class Recording:
    """What one camera that stands still saw, in time order."""

    files: tuple[Path, ...]
    """Of the colour images."""
    rgb: UInt8[np.ndarray, "frame height width 3"]
    """sRGB."""
    depth: Float32[np.ndarray, "frame height width"]
    """Planar z in metres, 0 where there is no return."""
    k: Float64[np.ndarray, "3 3"]
    """Camera matrix in pixels, pixel centres at +0.5."""

    def every(self, step: int) -> "Recording":
        """Of each square of so many pixels the one in its middle; nothing is averaged, for depths must not be.

        Raises:
            UsageError: the images are smaller than such a square.
        """
        if not 1 <= step <= min(self.depth.shape[1:]):
            raise UsageError(f"--every {step}: the images are {_size(self.depth[0])}; expected 1 or a little more.")
        offset = step // 2
        k = self.k.copy()
        k[:2, 2] -= offset + 0.5
        k[:2] /= step
        k[:2, 2] += 0.5
        pick = np.s_[:, offset::step, offset::step]
        return Recording(self.files, self.rgb[pick], self.depth[pick], k)


def read_recording(
    rgb: Sequence[Path], depth: Sequence[Path], k: Float64[np.ndarray, "3 3"], *, depth_scale: float
) -> Recording:
    """Read frames.

    Args:
        rgb: Images, or one folder of them, whose names give the order.
        depth: The same for depth images: 16 bits or floats, PNG, TIFF or NPY.
        k: Camera matrix in pixels, pixel centres at +0.5.
        depth_scale: Metres of one unit of depth images of whole numbers; floats are metres.

    Raises:
        UsageError: files are missing, of other sizes than the first, or hold no depth; or the camera matrix belongs to
            images of another size.
        CorruptFile: a file cannot be read.
    """
    colours, depths = _expand(rgb, COLOUR_ENDINGS, "--rgb"), _expand(depth, DEPTH_ENDINGS, "--depth")
    if len(colours) != len(depths):
        raise UsageError(
            f"--rgb names {len(colours)} images and --depth {len(depths)}; expected a pair for each frame."
        )
    images = [_read_rgb(path) for path in colours]
    maps = [_read_depth(path, depth_scale) for path in depths]
    for path, array in zip((*colours, *depths), (*images, *maps), strict=True):
        if array.shape[:2] != images[0].shape[:2]:
            raise UsageError(
                f"{path} is {_size(array)}, but {colours[0]} is {_size(images[0])}; all images must have one size, and "
                "depth must be aligned with colour."
            )
    _check_intrinsics(k, images[0])
    recording = Recording(tuple(colours), np.stack(images), np.stack(maps), k)
    _check_depth(recording.depth, depths[0])
    return recording


def parse_intrinsics(text: str | None) -> Float64[np.ndarray, "3 3"]:
    """The camera matrix of `fx,fy,cx,cy`.

    Raises:
        UsageError: it is something else, or missing.
    """
    if text is None:
        raise UsageError("--intrinsics is missing; give fx,fy,cx,cy in pixels, such as 525,525,320,240.")
    try:
        fx, fy, cx, cy = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--intrinsics {text}: expected fx,fy,cx,cy in pixels, such as 525,525,320,240.") from None
    if not (fx > 0 and fy > 0 and np.isfinite([fx, fy, cx, cy]).all()):
        raise UsageError(f"--intrinsics {text}: the focal lengths fx and fy must be positive, and all numbers finite.")
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def _expand(paths: Sequence[Path], endings: Sequence[str], flag: str) -> list[Path]:
    """The files themselves, in time order."""
    if not paths:
        raise UsageError(f"{flag} names no files; give images in time order, or one folder of them.")
    for path in paths:
        if not path.exists():
            raise UsageError(f"{flag} {path} does not exist.")
    if len(paths) > 1 or not paths[0].is_dir():
        return list(paths)
    found = [path for path in paths[0].iterdir() if path.suffix.lower() in endings]
    if not found:
        raise UsageError(f"{flag} {paths[0]}: the folder holds no {', '.join(endings)}.")
    return sorted(found, key=_by_number)


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Numbers in names count as numbers: 2.png comes before 10.png."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.name) if part]


def _read_rgb(path: Path) -> UInt8[np.ndarray, "height width 3"]:
    image = _open(path)
    if image.mode.startswith(("I", "F")):
        raise UsageError(f"{path} is no colour image (mode {image.mode}); are --rgb and --depth swapped?")
    return np.asarray(image.convert("RGB"))


def _read_depth(path: Path, scale: float) -> Float32[np.ndarray, "height width"]:
    values = _read_array(path) if path.suffix.lower() == ".npy" else _read_image(path)
    metres = values.astype(np.float32) * np.float32(scale if values.dtype.kind in "ui" else 1)
    return np.where(np.isfinite(metres) & (metres > 0), metres, np.float32(0))


def _read_image(path: Path) -> np.ndarray:
    image = _open(path)
    if not image.mode.startswith(("I", "F")):
        raise UsageError(
            f"{path} holds no depth: it has mode {image.mode}; expected one channel of 16 bits or of floats."
        )
    return np.asarray(image)


def _read_array(path: Path) -> np.ndarray:
    try:
        values = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise CorruptFile(f"{path} is damaged or no NPY file ({error}).") from None
    if not isinstance(values, np.ndarray) or values.ndim != 2 or values.dtype.kind not in "uif":
        raise UsageError(f"{path} holds no depth; expected an array of numbers with height and width.")
    return values


def _open(path: Path) -> Image.Image:
    """An image whose pixels are loaded."""
    try:
        image = Image.open(BytesIO(path.read_bytes()))
        image.load()
    except UnidentifiedImageError:
        raise CorruptFile(f"{path} is damaged or no image of a known format.") from None
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise CorruptFile(f"{path} is damaged or no image ({error}).") from None
    return image


def _check_intrinsics(k: Float64[np.ndarray, "3 3"], image: np.ndarray) -> None:
    """Refuse what no camera with such images has; the centre of a part cut out of an image may lie outside of it."""
    (height, width), (low, high) = image.shape[:2], FOCAL
    (fx, _, cx), (_, fy, cy), _ = k
    focal = all(low < value / max(height, width) < high for value in (fx, fy))
    if not focal or not (-width < cx < 2 * width and -height < cy < 2 * height):
        raise UsageError(
            f"--intrinsics {fx:g},{fy:g},{cx:g},{cy:g} cannot be those of images of {_size(image)}; expected "
            "fx,fy,cx,cy in pixels of these images. Where images were scaled, scale all four alike."
        )


def _check_depth(depth: Float32[np.ndarray, "frame height width"], example: Path) -> None:
    seen = depth[depth > 0]
    if not len(seen):
        raise UsageError(f"No pixel has a depth: {example} and the others hold only zeros.")
    median, (low, high) = float(np.median(seen)), PLAUSIBLE
    if not low < median < high:
        raise UsageError(
            f"The median depth is {median:.3g} m; expected {low:g} to {high:g}. Floats have to be metres; of whole "
            "numbers give the metres of one unit with --depth-scale: 0.001 for millimetres."
        )


def _size(array: np.ndarray) -> str:
    return f"{array.shape[1]}x{array.shape[0]}"
