"""RGB-D frames of a user: command-line flags, and conversion to model input."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Float64

from obpose.data.resolution import fitting_model, spacing_note, surface_spacing
from obpose.errors import UsageError
from obpose.geometry import unproject
from obpose.model.obpose import ObPose
from obpose.rgbd.plane import Plane
from obpose.rgbd.reading import Recording, parse_intrinsics, read_recording
from obpose.rgbd.table import find_table, table_points
from obpose.rgbd.world import FITTED, GIVEN, Pose, pose_over_plane, read_pose
from obpose.types import Observation

_COARSE = 5.0
"""Times the distance of neighbouring pixels in training; what is coarser most likely has depth of another unit."""
_MOST_OUTSIDE = 0.5
"""Share of the table's points."""
_MOST_TILT, _MOST_HEIGHT = 10.0, 0.02
"""Degrees and metres by which the table may differ from the plane z = 0: objects stand on that for the model, and it
leaves out what is beneath it."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Flags that name frames of one camera that stands still."""

    rgb: tuple[Path, ...] = ()
    """Colour images in time order, or one folder of them, sorted by the numbers in their names: PNG or JPEG whose
    pixels lie as they are shown (EXIF orientation 1)."""
    depth: tuple[Path, ...] = ()
    """Depth images, aligned with them, or one folder: PNG or TIFF of 16 bits, or TIFF or NPY of floats in metres. No
    depth: 0, values that are not finite, and the largest value of the type, such as 65535."""
    intrinsics: str | None = None
    """fx,fy,cx,cy in pixels; the centre of the first pixel is at 0.5, 0.5, so add 0.5 to OpenCV's cx and cy."""
    camera_pose: Path | None = None
    """File with world_from_camera, 4x4, metres, as text, JSON or NPY: camera axes x right, y down, z forward, world z
    up from the table at z = 0. If left out, the world stands on the largest plane near the camera."""
    depth_scale: float = 0.001
    """Metres of one unit of depth images of whole numbers."""
    every: int = 1
    """Take one pixel of each square of so many, such that a pixel shows about as much of the table as in training."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Frames as a model sees them, and notes for the user on how they compare to its training."""

    whole: Recording
    """With all pixels."""
    observation: Observation
    """A batch of one clip, of the pixels that were taken."""
    pose: Pose
    world: str
    """Note on the origin of the world frame."""
    resolution: str
    """Note on the distance of neighbouring pixels."""


def look(frames: Frames, model: ObPose) -> Sight:
    """Read frames for a model.

    Raises:
        UsageError: flags are missing or wrong, or files, or do not fit one another, or hold no depth.
        CorruptFile: a file cannot be read.
    """
    if not 0 < frames.depth_scale < math.inf:
        raise UsageError(f"--depth-scale is {frames.depth_scale:g}; expected more than 0, and finite.")
    if frames.every < 1:
        raise UsageError(f"--every {frames.every}: expected 1 or a little more.")
    k = parse_intrinsics(frames.intrinsics)
    given = None if frames.camera_pose is None else read_pose(frames.camera_pose)
    whole = read_recording(frames.rgb, frames.depth, k, depth_scale=frames.depth_scale)
    recording = whole.every(frames.every)
    if (recording.depth > 0).any() and not (recording.depth[0] > 0).any():
        raise UsageError(
            "The first frame has no depth, and objects are looked for there: leave out its image and its depth."
        )
    pose = _pose_over_table(recording, model) if given is None else given
    observation = _observation(recording, pose)
    world = FITTED if given is None else _given_note(observation, model)
    return Sight(whole, observation, pose, world, _resolution_note(model, observation, frames.every))


def _observation(recording: Recording, pose: Pose) -> Observation:
    depth = rearrange(torch.from_numpy(recording.depth), "frame h w -> 1 frame 1 h w")
    return Observation(
        rgb=rearrange(torch.from_numpy(recording.rgb), "frame h w c -> 1 frame 1 h w c").to(torch.float32) / 255,
        depth=depth,
        valid=depth > 0,
        k=torch.from_numpy(recording.k).to(torch.float32)[None, None],
        world_from_camera=torch.from_numpy(pose).to(torch.float32)[None, None],
    )


def _pose_over_table(recording: Recording, model: ObPose) -> Pose:
    seen = _first_points(_observation(recording, np.eye(4)))
    return pose_over_plane(seen, center=_middle_of_table(model))


def _middle_of_table(model: ObPose) -> tuple[float, float, float]:
    """Middle of the table in training, world frame, metres.

    Usually it is the origin. If a model was trained in another world, it is the point nearest to the origin in the
    middle half of the workspace.
    """
    trained = model.config.model
    quarter = trained.workspace_size / 4
    x, y, z = (min(max(0.0, middle - quarter), middle + quarter) for middle in trained.workspace_center)
    return x, y, z


def _given_note(observation: Observation, model: ObPose) -> str:
    """Describe whether the given world frame is like the one in training."""
    points, camera = _first_points(observation), observation.world_from_camera[0, 0, :3, 3].numpy()
    plane = find_table(points - camera)
    if plane is None:
        return GIVEN
    table = table_points(points - camera, plane) + camera
    faults = [fault for fault in (_away(table, model), _off_zero(table, plane)) if fault]
    return "; ".join([GIVEN, *faults, *(["results may be poor"] if faults else [])])


def _away(table: Float64[np.ndarray, "point 3"], model: ObPose) -> str | None:
    """Say how much of the table lies outside the cube that the model was trained on, if that is most of it."""
    trained = model.config.model
    center = np.array(trained.workspace_center)
    outside = (np.abs(table - center) > trained.workspace_size / 2).any(axis=1)
    if outside.mean() <= _MOST_OUTSIDE:
        return None
    middle = np.median(table, axis=0)
    return (
        f"the middle of the table in view lies at {_place(middle)}, and {100 * outside.mean():.0f} % of it outside the "
        f"{trained.workspace_size:.2f} m around {_place(center)} that the model was trained on: move the world's origin"
    )


def _place(point: Float64[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in point)})"


def _off_zero(table: Float64[np.ndarray, "point 3"], plane: Plane) -> str | None:
    """Say how the table lies, if that is not at z = 0."""
    tilt = math.degrees(math.acos(min(1.0, abs(float(plane.normal[2])))))
    if tilt > _MOST_TILT:
        return f"the table in view is tilted by {tilt:.0f} degrees: let the world's z axis point up from the table"
    height = float(np.median(table[:, 2]))
    if abs(height) <= _MOST_HEIGHT:
        return None
    return f"the table in view lies at z = {height:.2f} m: move the world's origin onto the table"


def _first_points(observation: Observation) -> Float64[np.ndarray, "point 3"]:
    """The points of the first frame, metres."""
    return unproject(observation)[0, 0][observation.valid[0, 0]].numpy().astype(np.float64)


def _resolution_note(model: ObPose, observation: Observation, every: int) -> str:
    """Compare the distance of neighbouring pixels to that of the training, and say what brings it nearer.

    Args:
        model: The model.
        observation: One pixel of each square of `every` pixels of the images.
        every: As given by the user; the hint replaces it.
    """
    words, trained, spacing = spacing_note(model, observation), model.config.model.spacing, surface_spacing(observation)
    if spacing is None or fitting_model(model, observation) is model:
        return words
    if spacing > _COARSE * trained * every:
        return f"{words}; is --depth-scale right?"
    step = max(1, round(every * trained / spacing))
    possible = step <= every * min(observation.depth.shape[-2:])
    return f"{words}; --every {step} comes near to it" if step != every and possible else words
