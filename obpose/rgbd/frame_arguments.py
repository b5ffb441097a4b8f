"""Command-line flags for the RGB-D frames of a user; imports nothing slow."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Flags that describe frames of one camera."""

    source: Annotated[Path | None, tyro.conf.Positional] = None
    """Folder or .npz file with colour, depth and their camera.json, in place of --rgb, --depth and --intrinsics; see
    docs/import.md for the layouts."""
    rgb: tuple[Path, ...] = ()
    """Colour images in time order, or one folder of them, sorted by the numbers in their names: PNG or JPEG with
    upright pixels (EXIF orientation 1)."""
    depth: tuple[Path, ...] = ()
    """Depth images, aligned with them, or one folder: PNG or TIFF of 16 bits, or TIFF, NPY or EXR of floats in metres.
    Missing depth: 0, values that are not finite, and the largest value of the type, such as 65535."""
    intrinsics: str | None = None
    """fx,fy,cx,cy in pixels; the centre of the first pixel is at 0.5, 0.5, so add 0.5 to OpenCV's cx and cy."""
    camera_pose: Path | None = None
    """File with world_from_camera, 4x4, metres, as text, JSON or NPY, or a folder with one for each frame: camera axes
    x right, y down, z forward, world z up. The world is kept if the table is at z = 0 there. Default: the poses in the
    source, or a world on the table."""
    depth_scale: float | None = None
    """Metres per unit of integer depth images; default that of camera.json, or 0.001."""
    euclidean: bool = False
    """Depth is the distance from the camera's centre, not along its axis."""
    depth_max: float | None = None
    """Ignore points that are farther from the camera, metres along its axis."""
    workspace: str | None = None
    """x0,x1,y0,y1: ignore points outside of this rectangle on the table, world frame, metres. Default: the visible
    part of the table."""
    table: str | None = None
    """x,y: column and row of a pixel of the first frame that shows the table. Default: the largest plane near the
    camera, and not a wall."""
    every: int | None = None
    """Use one pixel of each square of N x N. Default: such that pixels are as far apart on the table as in training."""
