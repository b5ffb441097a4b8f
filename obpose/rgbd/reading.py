"""Read RGB-D frames in the usual file formats as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from obpose.errors import UsageError
from obpose.rgbd.frame_files import check_pairs
from obpose.rgbd.frame_files import list_frames as _expand
from obpose.rgbd.images import Size, colour_size, depth_size, read_colour, read_depth

COLOUR_ENDINGS = (".png", ".jpg", ".jpeg")
DEPTH_ENDINGS = (".png", ".tif", ".tiff", ".npy")
PLAUSIBLE = (0.05, 50.0)
"""Metres between which the median depth of a recording must lie, for others come of a wrong scale; single pixels
outside have no return."""
FOCAL = (0.1, 50.0)
"""Larger sides of the image between which focal lengths must lie; others come of wrong units."""
MOST_BYTES = 2**30
"""Largest recording in memory."""
_PIXEL_BYTES = 7
"""Three bytes of colour and four of depth."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of one camera that stands still, in time order."""

    files: tuple[Path, ...]
    """The colour images."""
    rgb: UInt8[np.ndarray, "frame height width 3"]
    """sRGB."""
    depth: Float32[np.ndarray, "frame height width"]
    """Planar z in metres, 0 where there is no return."""
    k: Float64[np.ndarray, "3 3"]
    """Camera matrix in pixels, pixel centres at +0.5."""

    def every(self, step: int) -> "Recording":
        """Take the pixel in the middle of each square of `step` x `step`; nothing is averaged, for depths must not be.

        Raises:
            UsageError: the images are smaller than such a square.
        """
        height, width = self.depth.shape[1:]
        if not 1 <= step <= min(height, width):
            raise UsageError(f"--every {step}: the images are {width}x{height}; expected 1 or a little more.")
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
    """Read frames, after a check of all files' headers.

    Args:
        rgb: Images, or one folder of them, whose names give the order.
        depth: The same for depth images: 16 bits or floats, PNG, TIFF or NPY.
        k: Camera matrix in pixels, pixel centres at +0.5.
        depth_scale: Metres of one unit of depth images of whole numbers; floats are metres.

    Raises:
        UsageError: files are missing, do not belong together, hold no colours or no depth, or take more than
            `MOST_BYTES`; or the camera matrix belongs to images of another size.
        CorruptFile: a file cannot be read.
    """
    colours, depths = _expand(rgb, COLOUR_ENDINGS, "--rgb"), _expand(depth, DEPTH_ENDINGS, "--depth")
    if len(colours) != len(depths):
        raise UsageError(
            f"--rgb names {len(colours)} images and --depth {len(depths)}; expected a pair for each frame."
        )
    if rgb[0].is_dir() and depth[0].is_dir():
        check_pairs(colours, depths)
    width, height = _common_size(colours, depths)
    _check_memory(len(colours), (width, height))
    _check_intrinsics(k, (width, height))
    images = np.empty((len(colours), height, width, 3), np.uint8)
    maps = np.empty((len(colours), height, width), np.float32)
    for frame, (colour_path, depth_path) in enumerate(zip(colours, depths, strict=True)):
        images[frame] = read_colour(colour_path)
        maps[frame] = read_depth(depth_path, depth_scale)
    _check_depth(maps, depths[0])
    maps[(maps < PLAUSIBLE[0]) | (maps > PLAUSIBLE[1])] = 0
    return Recording(tuple(colours), images, maps, k)


def parse_intrinsics(text: str | None) -> Float64[np.ndarray, "3 3"]:
    """Make the camera matrix of the text `fx,fy,cx,cy`.

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


def _common_size(colours: Sequence[Path], depths: Sequence[Path]) -> Size:
    """Width and height that all images have, by their headers."""
    first = colour_size(colours[0])
    for paths, size_of in ((colours, colour_size), (depths, depth_size)):
        for path in paths:
            if (size := size_of(path)) != first:
                raise UsageError(
                    f"{path} is {_text(size)}, but {colours[0]} is {_text(first)}; all images must have one size, and "
                    "depth must be aligned with colour."
                )
    return first


def _check_memory(frames: int, size: Size) -> None:
    needed = frames * size[0] * size[1] * _PIXEL_BYTES
    if needed > MOST_BYTES:
        raise UsageError(
            f"{frames} frames of {_text(size)} pixels need {needed / 2**30:.1f} GiB of memory; expected at most "
            f"{MOST_BYTES // 2**30} GiB. Give fewer frames at a time, or smaller images."
        )


def _check_intrinsics(k: Float64[np.ndarray, "3 3"], size: Size) -> None:
    """Refuse what no camera with such images has; the centre of a part cut out of an image may lie outside of it."""
    (width, height), (low, high) = size, FOCAL
    (fx, _, cx), (_, fy, cy), _ = k
    focal = all(low < value / max(height, width) < high for value in (fx, fy))
    if not focal or not (-width < cx < 2 * width and -height < cy < 2 * height):
        raise UsageError(
            f"--intrinsics {fx:g},{fy:g},{cx:g},{cy:g} cannot be those of images of {_text(size)}; expected "
            "fx,fy,cx,cy in pixels of these images. Where images were scaled, scale all four alike."
        )


def _check_depth(depth: Float32[np.ndarray, "frame height width"], example: Path) -> None:
    seen = depth[depth > 0]
    if not len(seen):
        raise UsageError(
            f"No pixel has a depth: {example} and the others hold only zeros, or the largest value of their type."
        )
    median, (low, high) = float(np.median(seen, overwrite_input=True)), PLAUSIBLE
    if not low < median < high:
        raise UsageError(
            f"The median depth is {median:.3g} m; expected {low:g} to {high:g}. Floats have to be metres; of whole "
            "numbers give the metres of one unit with --depth-scale: 0.001 for millimetres."
        )


def _text(size: Size) -> str:
    return f"{size[0]}x{size[1]}"
