"""Recordings of RGB-D frames, read from image files."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from datagen.rgbd.camera_file import Camera
from datagen.rgbd.files import check_intrinsics, common_size
from datagen.rgbd.frame_files import list_frames
from datagen.rgbd.images import Size, read_colour
from datagen.rgbd.layouts import COLOUR_ENDINGS, DEPTH_ENDINGS, FrameFiles, paired
from obpose.errors import UsageError

PLAUSIBLE_DEPTH = (0.05, 50.0)
"""Range of the median depth in metres; other medians indicate a wrong scale. Single pixels outside count as missing."""
MAX_BYTES = 2**30
"""Largest size of a recording in memory."""
_PIXEL_BYTES = 7
"""Three bytes of colour and four of depth."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Frames of one camera, in time order."""

    files: tuple[Path, ...]
    """Paths of the colour images."""
    rgb: UInt8[np.ndarray, "frame height width 3"]
    """sRGB."""
    depth: Float32[np.ndarray, "frame height width"]
    """Planar depth in metres, 0 = missing."""
    k: Float64[np.ndarray, "3 3"]
    """Camera matrix in pixels, pixel centres at +0.5."""
    poses: Float64[np.ndarray, "frame 4 4"] | None = None
    """world_from_camera, metres; None if unknown."""
    left_out: int = 0
    """Number of colour images without depth or pose at their time."""

    def every(self, step: int) -> "Recording":
        """Take the centre pixel of each square of `step` x `step` pixels, because averages of depth are invalid."""
        offset = step // 2
        k = self.k.copy()
        k[:2, 2] -= offset + 0.5
        k[:2] /= step
        k[:2, 2] += 0.5
        pick = np.s_[:, offset::step, offset::step]
        return replace(self, rgb=self.rgb[pick], depth=self.depth[pick], k=k)


def named_files(rgb: Sequence[Path], depth: Sequence[Path]) -> FrameFiles:
    """List frames by their files in time order, or by a folder each, sorted by name or paired by time.

    Raises:
        UsageError: files are missing, or do not belong together.
    """
    colours, depths = list_frames(rgb, COLOUR_ENDINGS, "--rgb"), list_frames(depth, DEPTH_ENDINGS, "--depth")
    if rgb[0].is_dir() and depth[0].is_dir():
        return paired(rgb[0], colours, depths, [])
    if len(colours) != len(depths):
        raise UsageError(
            f"--rgb names {len(colours)} images and --depth {len(depths)}; expected a pair for each frame."
        )
    return FrameFiles(colours[0].parent, colours, depths, [])


def read_recording(
    files: FrameFiles, camera: Camera, *, lens: str = "--intrinsics", max_bytes: int = MAX_BYTES
) -> Recording:
    """Read frames, after a check of all file headers; `lens` names the source of the camera matrix in messages.

    Raises:
        UsageError: files hold no colours or no depth, differ in size, or are too large; or the camera matrix belongs to
            images of another size.
        CorruptFile: a file cannot be read.
    """
    size = common_size(files.colour, files.depth)
    _check_memory(len(files.colour), size, max_bytes)
    if len(camera.lenses) > 1:
        raise UsageError(f"{camera.file} holds {len(camera.lenses)} camera matrices; expected one for all frames.")
    check_intrinsics(camera.k(), size, lens)
    rgb = np.stack([read_colour(path) for path in files.colour])
    depth = np.stack([camera.depth(path) for path in files.depth])
    _check_depth(depth, files.depth[0])
    depth[(depth < PLAUSIBLE_DEPTH[0]) | (depth > PLAUSIBLE_DEPTH[1])] = 0
    poses = [files.pose(number, camera) for number in range(len(rgb))]
    known = None if any(pose is None for pose in poses) else np.array(poses, np.float64)
    return Recording(tuple(files.colour), rgb, depth, camera.k(), known, files.left_out)


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


def _check_memory(frames: int, size: Size, max_bytes: int) -> None:
    needed = frames * size[0] * size[1] * _PIXEL_BYTES
    if needed > max_bytes:
        raise UsageError(
            f"{frames} frames of {size[0]}x{size[1]} pixels need {needed / 2**30:.1f} GiB of memory; expected at most "
            f"{max_bytes / 2**30:g} GiB. Give fewer frames at a time, or smaller images."
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
