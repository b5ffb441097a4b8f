"""Recordings of RGB-D frames, read from image files."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from datagen.geometry import pixel_rays
from datagen.rgbd.frame_files import check_pairs, list_frames
from datagen.rgbd.images import Size, colour_size, depth_size, read_colour, read_depth
from obpose.errors import UsageError

COLOUR_ENDINGS = (".png", ".jpg", ".jpeg")
DEPTH_ENDINGS = (".png", ".tif", ".tiff", ".npy")
PLAUSIBLE_DEPTH = (0.05, 50.0)
"""Range of the median depth in metres; other medians indicate a wrong scale. Single pixels outside count as missing."""
PLAUSIBLE_FOCAL = (0.1, 50.0)
"""Range of focal lengths, relative to the longer side of the image; others indicate wrong units."""
MAX_BYTES = 2**30
"""Largest size of a recording in memory."""
_PIXEL_BYTES = 7
"""Three bytes of colour and four of depth."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of one static camera, in time order."""

    files: tuple[Path, ...]
    """Paths of the colour images."""
    rgb: UInt8[np.ndarray, "frame height width 3"]
    """sRGB."""
    depth: Float32[np.ndarray, "frame height width"]
    """Planar depth in metres, 0 = missing."""
    k: Float64[np.ndarray, "3 3"]
    """Camera matrix in pixels, pixel centres at +0.5."""

    def planar(self) -> "Recording":
        """Convert depth from distances from the camera's centre to distances along its axis."""
        height, width = self.depth.shape[1:]
        lengths = np.linalg.norm(pixel_rays(self.k, width, height), axis=-1)
        return replace(self, depth=(self.depth / lengths).astype(np.float32))

    def every(self, step: int) -> "Recording":
        """Take the centre pixel of each square of `step` x `step` pixels, because averages of depth are invalid.

        Raises:
            UsageError: the images are smaller than such a square.
        """
        height, width = self.depth.shape[1:]
        if not 1 <= step <= min(height, width):
            raise UsageError(f"--every {step}: the images are {width}x{height}; expected 1 to {min(height, width)}.")
        offset = step // 2
        k = self.k.copy()
        k[:2, 2] -= offset + 0.5
        k[:2] /= step
        k[:2, 2] += 0.5
        pick = np.s_[:, offset::step, offset::step]
        return Recording(self.files, self.rgb[pick], self.depth[pick], k)


def read_recording(
    rgb: Sequence[Path],
    depth: Sequence[Path],
    k: Float64[np.ndarray, "3 3"],
    *,
    depth_scale: float,
    max_bytes: int = MAX_BYTES,
) -> Recording:
    """Read frames, after a check of all file headers.

    Colour and depth images are files in time order, or a folder each, sorted by name. `k` is the camera matrix in
    pixels, with pixel centres at +0.5. `depth_scale` is in metres per unit of integer depth images; floats are metres.

    Raises:
        UsageError: files are missing, do not belong together, hold no colours or no depth, or are too large; or the
            camera matrix belongs to images of another size.
        CorruptFile: a file cannot be read.
    """
    colours, depths = list_frames(rgb, COLOUR_ENDINGS, "--rgb"), list_frames(depth, DEPTH_ENDINGS, "--depth")
    if len(colours) != len(depths):
        raise UsageError(
            f"--rgb names {len(colours)} images and --depth {len(depths)}; expected a pair for each frame."
        )
    if rgb[0].is_dir() and depth[0].is_dir():
        check_pairs(colours, depths)
    width, height = size = _common_size(colours, depths)
    _check_memory(len(colours), size, max_bytes)
    _check_intrinsics(k, size)
    images = np.empty((len(colours), height, width, 3), np.uint8)
    maps = np.empty((len(colours), height, width), np.float32)
    for frame, (colour_path, depth_path) in enumerate(zip(colours, depths, strict=True)):
        images[frame] = read_colour(colour_path)
        maps[frame] = read_depth(depth_path, depth_scale)
    _check_depth(maps, depths[0])
    maps[(maps < PLAUSIBLE_DEPTH[0]) | (maps > PLAUSIBLE_DEPTH[1])] = 0
    return Recording(tuple(colours), images, maps, k)


def parse_intrinsics(text: str | None) -> Float64[np.ndarray, "3 3"]:
    """Parse `fx,fy,cx,cy` as a camera matrix.

    Raises:
        UsageError: the text is missing or has another form.
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
    """Check by the headers that all images have one size."""
    first = colour_size(colours[0])
    for paths, size_of in ((colours, colour_size), (depths, depth_size)):
        for path in paths:
            if (size := size_of(path)) != first:
                raise UsageError(
                    f"{path} is {_text(size)}, but {colours[0]} is {_text(first)}; all images must have one size, and "
                    "depth must be aligned with colour."
                )
    return first


def _check_memory(frames: int, size: Size, max_bytes: int) -> None:
    needed = frames * size[0] * size[1] * _PIXEL_BYTES
    if needed > max_bytes:
        raise UsageError(
            f"{frames} frames of {_text(size)} pixels need {needed / 2**30:.1f} GiB of memory; expected at most "
            f"{max_bytes / 2**30:g} GiB. Give fewer frames at a time, or smaller images."
        )


def _check_intrinsics(k: Float64[np.ndarray, "3 3"], size: Size) -> None:
    """Refuse implausible intrinsics; the principal point of a cropped image may lie outside of it."""
    (width, height), (low, high) = size, PLAUSIBLE_FOCAL
    (fx, _, cx), (_, fy, cy), _ = k
    is_plausible = all(low < value / max(height, width) < high for value in (fx, fy))
    if not is_plausible or not (-width < cx < 2 * width and -height < cy < 2 * height):
        raise UsageError(
            f"--intrinsics {fx:g},{fy:g},{cx:g},{cy:g} cannot be those of images of {_text(size)}; expected "
            "fx,fy,cx,cy in pixels of these images. If the images were resized, scale all four alike."
        )


def _check_depth(depth: Float32[np.ndarray, "frame height width"], example: Path) -> None:
    known = depth[depth > 0]
    if not len(known):
        raise UsageError(
            f"No pixel has a depth: {example} and the others hold only zeros, negative numbers, NaN or infinity, or "
            "the largest value of their type."
        )
    median, (low, high) = float(np.median(known, overwrite_input=True)), PLAUSIBLE_DEPTH
    if not low < median < high:
        raise UsageError(
            f"The median depth is {median:.3g} m; expected {low:g} to {high:g}. Floats have to be metres; for "
            "integers, give the metres per unit with --depth-scale, such as 0.001 for millimetres."
        )


def _text(size: Size) -> str:
    return f"{size[0]}x{size[1]}"
