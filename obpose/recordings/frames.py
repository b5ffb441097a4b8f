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
from obpose.plane import TOLERANCE, fit_plane
from obpose.recordings.reading import Recording, parse_intrinsics, read_recording
from obpose.recordings.world import FITTED, GIVEN, Pose, middle_of, pose_over_plane, read_pose
from obpose.resolution import fitting_model, spacing_note, surface_spacing
from obpose.types import Observation

_COARSE = 5.0
"""Times the distance of neighbouring pixels in training; what is coarser most likely has depth of another unit."""
_MOST_OUTSIDE = 0.5
"""Share of the points in view."""
_MOST_TILT, _MOST_HEIGHT = 10.0, 0.02
"""Degrees and metres by which the table may differ from the plane z = 0: objects stand on that for the model, and it
leaves out what is beneath it."""


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
    if (recording.depth > 0).any() and not (recording.depth[0] > 0).any():
        raise UsageError(
            "The first frame has no depth, and objects are looked for there: leave out its image and its depth."
        )
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
    points = _first_points(observation)
    faults = [fault for fault in (_away(points, model), _off_the_table(points)) if fault]
    return "; ".join([GIVEN, *faults, *(["results may be poor"] if faults else [])])


def _away(points: Float64[np.ndarray, "point 3"], model: ObPose) -> str | None:
    """How much of what is in view lies outside the cube that the model was trained on, if that is most of it."""
    trained = model.config.model
    center = np.array(trained.workspace_center)
    outside = (np.abs(points - center) > trained.workspace_size / 2).any(axis=1)
    if not len(points) or outside.mean() <= _MOST_OUTSIDE:
        return None
    away = float(np.linalg.norm(middle_of(points) - center))
    x, y, z = center
    return (
        f"what is in view lies {away:.2f} m from ({x:.2f}, {y:.2f}, {z:.2f}), around which the model was trained, and "
        f"{100 * outside.mean():.0f} % of it outside the {trained.workspace_size:.2f} m there: move the world's origin"
    )


def _off_the_table(points: Float64[np.ndarray, "point 3"]) -> str | None:
    """How the largest plane in view lies, if that is not at z = 0."""
    plane = fit_plane(points, np.random.default_rng(0))
    if plane is None:
        return None
    tilt = math.degrees(math.acos(min(1.0, abs(float(plane.normal[2])))))
    if tilt > _MOST_TILT:
        return (
            f"the largest plane in view is tilted by {tilt:.0f} degrees: let the world's z axis point up from the table"
        )
    heights = points[np.abs(plane.height(points)) < TOLERANCE, 2]
    height = float(np.median(heights)) if len(heights) else 0.0
    if abs(height) <= _MOST_HEIGHT:
        return None
    return f"the largest plane in view lies at z = {height:.2f} m: move the world's origin onto the table"


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
