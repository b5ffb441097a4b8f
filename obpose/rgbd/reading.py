"""Read the RGB-D frames of a user that command-line flags describe."""

import math
from dataclasses import replace

import numpy as np

from datagen.rgbd.camera_file import CAMERA, Camera, read_camera
from datagen.rgbd.layouts import FrameFiles, find_frames, read_poses
from obpose.errors import UsageError
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.recording import Recording, named_files, parse_intrinsics, read_recording

_LEAST_EDGE = 8
"""Least height and width in pixels of the images that a given `--every` leaves."""
_EXAMPLE = '{"fx": 525, "fy": 525, "cx": 319.5, "cy": 239.5, "depth_scale": 0.001}'


def read_frames(frames: Frames) -> Recording:
    """Read the frames that the flags describe.

    Raises:
        UsageError: flags or files are missing or wrong, or contradict each other.
        CorruptFile: a file cannot be read.
    """
    if frames.depth_scale is not None and not 0 < frames.depth_scale < math.inf:
        raise UsageError(f"--depth-scale is {frames.depth_scale:g}; expected more than 0, and finite.")
    if frames.every is not None and frames.every < 1:
        raise UsageError(f"--every {frames.every}: expected 1 or more.")
    if frames.depth_max is not None and not frames.depth_max > 0:
        raise UsageError(f"--depth-max is {frames.depth_max:g}; expected metres, more than 0.")
    files, camera = _files(frames)
    named = frames.intrinsics is not None or files.camera is None
    recording = read_recording(files, camera, lens="--intrinsics" if named else str(files.camera))
    if frames.depth_max is not None:
        recording = replace(recording, depth=np.where(recording.depth > frames.depth_max, 0, recording.depth))
    if frames.every is not None:
        _check_every(frames.every, recording)
    return recording


def _check_every(every: int, recording: Recording) -> None:
    """Check that the reduced images are large enough; frames in full resolution may have any size."""
    height, width = recording.depth.shape[1:]
    rows, columns = (len(range(every // 2, edge, every)) for edge in (height, width))
    if every > 1 and min(rows, columns) < _LEAST_EDGE:
        raise UsageError(
            f"--every {every} leaves {columns}x{rows} of the {width}x{height} pixels; expected at least {_LEAST_EDGE} "
            "along each edge. Give a smaller one, or leave it out."
        )


def _files(frames: Frames) -> tuple[FrameFiles, Camera]:
    """Find the files of the frames, and their camera."""
    needed = frames.source is None or frames.intrinsics is not None
    k = parse_intrinsics(frames.intrinsics) if needed else None
    if frames.source is None:
        files = named_files(frames.rgb, frames.depth)
    elif frames.rgb or frames.depth:
        raise UsageError(f"{frames.source} and --rgb or --depth exclude each other; give one of them.")
    elif not frames.source.exists():
        raise UsageError(f"{frames.source} does not exist; expected a folder or .npz file with frames of one camera.")
    elif (found := find_frames(frames.source)) is None:
        raise UsageError(
            f"{frames.source} holds no frames; expected a folder or .npz file with colour and depth of one camera, "
            "such as rgb/*.png and depth/*.png, or color.png and depth.png."
        )
    else:
        files = found
    if frames.camera_pose is not None:
        files = replace(files, poses=read_poses(frames.camera_pose, len(files.colour)))
    if files.camera is None:
        if k is None:
            lacks = (
                f"holds no array K, and there is no {CAMERA} beside it" if files.place.is_file() else f"has no {CAMERA}"
            )
            raise UsageError(f"{files.place} {lacks}; write one such as {_EXAMPLE}, or give --intrinsics.")
        camera = Camera(k[None], frames.depth_scale or files.depth_scale, euclidean=frames.euclidean)
    else:
        kind = "euclidean" if frames.euclidean else None
        camera = read_camera(files.camera, depth_type=kind, k=k, default_scale=files.depth_scale)
        camera = replace(camera, depth_scale=frames.depth_scale or camera.depth_scale)
    return files, camera


def parse_pixel(text: str) -> tuple[int, int]:
    """Parse column and row of a pixel; raises UsageError."""
    try:
        column, row = (int(part) for part in text.split(","))
    except ValueError:
        raise UsageError(
            f"--table {text}: expected column,row of a pixel of the first frame, such as 320,400."
        ) from None
    return column, row


def parse_rectangle(text: str) -> tuple[float, float, float, float]:
    """Parse a rectangle on the table; raises UsageError."""
    try:
        x0, x1, y0, y1 = (float(part) for part in text.split(","))
    except ValueError:
        x0, x1, y0, y1 = (math.nan,) * 4
    if not (x0 < x1 and y0 < y1 and np.isfinite([x0, x1, y0, y1]).all()):
        raise UsageError(f"--workspace {text}: expected x0,x1,y0,y1 in metres with x0 < x1 and y0 < y1.")
    return x0, x1, y0, y1
