"""A user's own RGB-D frames, as commands take them, and as a model sees them."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Float64

from obpose.errors import UsageError
from obpose.geometry import unproject
from obpose.model import ObPose
from obpose.recordings.reading import Recording, parse_intrinsics, read_recording
from obpose.recordings.world import FITTED, GIVEN, Pose, middle_of, pose_over_plane, read_pose
from obpose.resolution import fitting_model, spacing_note, surface_spacing
from obpose.types import Observation

_COARSE = 5.0
"""Times the distance of neighbouring pixels in training; what is coarser most likely has depth of another unit."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Flags that name frames of one camera that stands still."""

    rgb: tuple[Path, ...] = ()
    """Colour images in time order, or one folder of them."""
    depth: tuple[Path, ...] = ()
    """Depth images, aligned with them, or one folder: PNG or TIFF of 16 bits, or TIFF or NPY of floats in metres."""
    intrinsics: str | None = None
    """fx,fy,cx,cy in pixels; the centre of the first pixel is at 0.5, 0.5, so add 0.5 to OpenCV's cx and cy."""
    camera_pose: Path | None = None
    """File with world_from_camera, 4x4, metres, as text, JSON or NPY: camera axes x right, y down, z forward, world z
    up from the table at z = 0. If left out, the world stands on the largest plane in view."""
    depth_scale: float = 0.001
    """Metres of one unit of depth images of whole numbers."""
    every: int = 1
    """Take one pixel of each square of so many, such that a pixel shows about as much of the table as in training."""


@dataclass(frozen=True, eq=False)
class Sight:
    """What a model sees of frames, and what is to be said of it."""

    whole: Recording
    """With all pixels."""
    observation: Observation
    """A batch of one clip, of the pixels that were taken."""
    pose: Pose
    world: str
    """Where the world is from."""
    resolution: str
    """How the frames compare to those of the training."""


def look(frames: Frames, model: ObPose) -> Sight:
    """Read frames for a model.

    Raises:
        UsageError: flags are missing or wrong, or files, or do not fit one another, or hold no depth.
        CorruptFile: a file cannot be read.
    """
    if not 0 < frames.depth_scale < math.inf:
        raise UsageError(f"--depth-scale is {frames.depth_scale:g}; expected more than 0, and finite.")
    k = parse_intrinsics(frames.intrinsics)
    whole = read_recording(frames.rgb, frames.depth, k, depth_scale=frames.depth_scale)
    recording = whole.every(frames.every)
    pose = read_pose(frames.camera_pose) if frames.camera_pose else _pose_over_plane(recording, model)
    observation = _observation(recording, pose)
    world = _given_note(observation, model) if frames.camera_pose else FITTED
    return Sight(whole, observation, pose, world, _resolution_note(model, observation))


def _observation(recording: Recording, pose: Pose) -> Observation:
    depth = rearrange(torch.from_numpy(recording.depth), "frame h w -> 1 frame 1 h w")
    return Observation(
        rgb=rearrange(torch.from_numpy(recording.rgb), "frame h w c -> 1 frame 1 h w c").to(torch.float32) / 255,
        depth=depth,
        valid=depth > 0,
        k=torch.from_numpy(recording.k).to(torch.float32)[None, None],
        world_from_camera=torch.from_numpy(pose).to(torch.float32)[None, None],
    )


def _pose_over_plane(recording: Recording, model: ObPose) -> Pose:
    seen = _first_points(_observation(recording, np.eye(4)))
    return pose_over_plane(seen, center=model.config.model.workspace_center)


def _given_note(observation: Observation, model: ObPose) -> str:
    """Whether the given world is one that the model knows."""
    points, trained = _first_points(observation), model.config.model
    away = float(np.linalg.norm(middle_of(points) - trained.workspace_center)) if len(points) else 0.0
    if away < trained.workspace_size / 2:
        return GIVEN
    x, y, z = trained.workspace_center
    return (
        f"{GIVEN}; what is in view lies {away:.2f} m from ({x:.2f}, {y:.2f}, {z:.2f}), around which the model was "
        "trained: results may be poor, move the world's origin there"
    )


def _first_points(observation: Observation) -> Float64[np.ndarray, "point 3"]:
    """What the first frame shows, metres."""
    return unproject(observation)[0, 0][observation.valid[0, 0]].numpy().astype(np.float64)


def _resolution_note(model: ObPose, observation: Observation) -> str:
    """How the distance of neighbouring pixels compares to the training's, and what brings it nearer."""
    words, trained, spacing = spacing_note(model, observation), model.config.model.spacing, surface_spacing(observation)
    if spacing is None or fitting_model(model, observation) is model:
        return words
    if spacing > _COARSE * trained:
        return f"{words}; is --depth-scale right?"
    step = round(trained / spacing)
    return f"{words}; --every {step} comes near to it" if step > 1 else words
