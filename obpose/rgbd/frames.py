"""RGB-D frames of a user as model input: command-line flags, world frame, and comparison to the training."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Float64

from datagen.rgbd.camera_pose import Pose, read_pose
from datagen.rgbd.table import find_table, pose_over_table, table_points
from obpose.data.resolution import fitting_model, spacing_note, surface_spacing
from obpose.errors import UsageError
from obpose.geometry import unproject
from obpose.model.obpose import ObPose
from obpose.rgbd.recording import Recording, parse_intrinsics, read_recording
from obpose.types import Observation

GIVEN = "as given with --camera-pose"
FITTED = (
    "stands on the largest plane near the camera in the first frame, most likely the table: z = 0 is the plane and z "
    "points up, x points horizontally towards the camera, and the origin is the median of the plane's points"
)
_COARSE = 5.0
"""Pixel spacing relative to the training above which the unit of depth is most likely wrong."""
_MOST_OUTSIDE = 0.5
"""Largest share of the table's points outside the workspace without a warning."""
_MOST_TILT, _MOST_HEIGHT = 10.0, 0.02
"""Largest tilt in degrees and height in metres of the table without a warning. The model expects objects to stand on
z = 0 and ignores everything below."""


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Flags that describe frames of one static camera."""

    rgb: tuple[Path, ...] = ()
    """Colour images in time order, or one folder of them, sorted by the numbers in their names: PNG or JPEG with
    upright pixels (EXIF orientation 1)."""
    depth: tuple[Path, ...] = ()
    """Depth images, aligned with them, or one folder: PNG or TIFF of 16 bits, or TIFF or NPY of floats in metres.
    Missing depth: 0, values that are not finite, and the largest value of the type, such as 65535."""
    intrinsics: str | None = None
    """fx,fy,cx,cy in pixels; the centre of the first pixel is at 0.5, 0.5, so add 0.5 to OpenCV's cx and cy."""
    camera_pose: Path | None = None
    """File with world_from_camera, 4x4, metres, as text, JSON or NPY: camera axes x right, y down, z forward, world z
    up from the table at z = 0. Default: a world on the largest plane near the camera."""
    depth_scale: float = 0.001
    """Metres per unit of integer depth images."""
    every: int = 1
    """Use one pixel of each square of N x N, such that a pixel shows about as much of the table as in training."""


@dataclass(frozen=True, eq=False)
class PreparedFrames:
    """Frames as model input, and notes for the user on how they compare to the training."""

    recording: Recording
    """The frames in full resolution."""
    observation: Observation
    """A batch of one clip, with the pixels that `--every` selects."""
    pose: Pose
    """world_from_camera."""
    world: str
    """Note on the origin of the world frame."""
    resolution: str
    """Note on the pixel spacing."""


def prepare_frames(frames: Frames, model: ObPose) -> PreparedFrames:
    """Read frames for a model.

    Raises:
        UsageError: flags or files are missing or wrong, contradict each other, or hold no depth.
        CorruptFile: a file cannot be read.
    """
    if not 0 < frames.depth_scale < math.inf:
        raise UsageError(f"--depth-scale is {frames.depth_scale:g}; expected more than 0, and finite.")
    if frames.every < 1:
        raise UsageError(f"--every {frames.every}: expected 1 or a little more.")
    k = parse_intrinsics(frames.intrinsics)
    given = None if frames.camera_pose is None else read_pose(frames.camera_pose)
    recording = read_recording(frames.rgb, frames.depth, k, depth_scale=frames.depth_scale)
    reduced = recording.every(frames.every)
    if (reduced.depth > 0).any() and not (reduced.depth[0] > 0).any():
        raise UsageError(
            "The first frame has no depth, and objects are looked for there: leave out its image and its depth."
        )
    if given is None:
        points = _first_points(_observation(reduced, np.eye(4)))
        pose, world = pose_over_table(points, center=table_middle(model)), FITTED
    else:
        pose, world = given, world_note(_observation(reduced, given), model)
    observation = _observation(reduced, pose)
    return PreparedFrames(recording, observation, pose, world, _resolution_note(model, observation, frames.every))


def _observation(recording: Recording, pose: Pose) -> Observation:
    depth = rearrange(torch.from_numpy(recording.depth), "frame h w -> 1 frame 1 h w")
    return Observation(
        rgb=rearrange(torch.from_numpy(recording.rgb), "frame h w c -> 1 frame 1 h w c").to(torch.float32) / 255,
        depth=depth,
        valid=depth > 0,
        k=torch.from_numpy(recording.k).to(torch.float32)[None, None],
        world_from_camera=torch.from_numpy(pose).to(torch.float32)[None, None],
    )


def table_middle(model: ObPose) -> tuple[float, float, float]:
    """Middle of the table in training, world frame, metres.

    Usually the origin. For models trained in another world, it is the point nearest to the origin in the middle half
    of the workspace.
    """
    trained = model.config.model
    quarter = trained.workspace_size / 4
    x, y, z = (min(max(0.0, middle - quarter), middle + quarter) for middle in trained.workspace_center)
    return x, y, z


def world_note(observation: Observation, model: ObPose) -> str:
    """Describe whether a given world frame is like the one in training."""
    points, camera = _first_points(observation), observation.world_from_camera[0, 0, :3, 3].numpy()
    plane = find_table(points - camera)
    if plane is None:
        return GIVEN
    table = table_points(points - camera, plane) + camera
    faults = [*_outside_workspace(table, model), *_off_zero(table, plane.normal)]
    return "; ".join([GIVEN, *faults, *(["results may be poor"] if faults else [])])


def _outside_workspace(table: Float64[np.ndarray, "point 3"], model: ObPose) -> list[str]:
    """Warn if most of the table lies outside the workspace of the training."""
    trained = model.config.model
    center = np.array(trained.workspace_center)
    outside = (np.abs(table - center) > trained.workspace_size / 2).any(axis=1).mean()
    if outside <= _MOST_OUTSIDE:
        return []
    middle, expected = (
        f"({', '.join(f'{value:.2f}' for value in point)})" for point in (np.median(table, axis=0), center)
    )
    return [
        f"the middle of the table in view lies at {middle}, and {100 * outside:.0f} % of it outside the "
        f"{trained.workspace_size:.2f} m around {expected} that the model was trained on: move the world's origin"
    ]


def _off_zero(table: Float64[np.ndarray, "point 3"], normal: Float64[np.ndarray, "3"]) -> list[str]:
    """Warn if the table is not level at z = 0."""
    tilt = math.degrees(math.acos(min(1.0, abs(float(normal[2])))))
    if tilt > _MOST_TILT:
        return [f"the table in view is tilted by {tilt:.0f} degrees: let the world's z axis point up from the table"]
    height = float(np.median(table[:, 2]))
    if abs(height) > _MOST_HEIGHT:
        return [f"the table in view lies at z = {height:.2f} m: move the world's origin onto the table"]
    return []


def _first_points(observation: Observation) -> Float64[np.ndarray, "point 3"]:
    """Unproject the first frame, metres."""
    return unproject(observation)[0, 0][observation.valid[0, 0]].numpy().astype(np.float64)


def _resolution_note(model: ObPose, observation: Observation, every: int) -> str:
    """Compare the pixel spacing to the training, and recommend a value of `--every`."""
    note, trained, spacing = spacing_note(model, observation), model.config.model.spacing, surface_spacing(observation)
    if spacing is None or fitting_model(model, observation) is model:
        return note
    if spacing > _COARSE * trained * every:
        return f"{note}; is --depth-scale right?"
    step = max(1, round(every * trained / spacing))
    possible = step <= every * min(observation.depth.shape[-2:])
    return f"{note}; --every {step} comes near to it" if step != every and possible else note
