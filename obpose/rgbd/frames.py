"""RGB-D frames of a user as model input: world frame, table, and resolution."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Float64

from datagen.geometry import unproject
from datagen.rgbd.camera_pose import Pose, read_pose
from datagen.rgbd.table import find_table, pose_over_table, table_points
from obpose.config import Config
from obpose.contact.config import ContactConfig
from obpose.data.resolution import surface_spacing
from obpose.errors import UsageError
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.recording import Recording, parse_intrinsics, read_recording
from obpose.rgbd.workspace import Workspace, find_workspace, rectangle
from obpose.systems import architecture_of
from obpose.trainable import Configuration
from obpose.types import Observation

GIVEN = "as given with --camera-pose"
FITTED = (
    "stands on the largest plane near the camera in the first frame, most likely the table: z = 0 is the plane and z "
    "points up, x points horizontally towards the camera, and the origin is the median of the plane's points"
)
_COARSE = 5.0
"""Pixel spacing relative to the training above which the unit of depth is most likely wrong."""
_LEAST_EDGE = 24
"""Least height and width in pixels of the images that a model gets, unless the frames are smaller."""
_MOST_TILT, _MOST_HEIGHT = 10.0, 0.02
"""Largest tilt in degrees and height in metres of the table without a warning. Models expect objects to stand on z = 0
and ignore everything below."""


@dataclass(frozen=True)
class Trained:
    """Scenes that a model was trained on."""

    spacing: float
    """Median distance in metres between the surface points of neighbouring pixels."""
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Middle of the table, world frame, metres."""
    learned: bool = True
    """Whether these are facts about a training; otherwise the spacing is only recommended."""
    cube: tuple[tuple[float, float, float], float] | None = None
    """Centre and edge of the cube that holds all objects, metres; None if the model has no such bound."""


def trained_on(config: Configuration) -> Trained:
    """Describe the scenes that a model with this configuration was trained on."""
    match config:
        case Config(model=model):
            # The point of the table nearest to the origin in the middle half of the workspace, usually the origin.
            quarter = model.workspace_size / 4
            x, y, z = (min(max(0.0, middle - quarter), middle + quarter) for middle in model.workspace_center)
            return Trained(model.spacing, (x, y, z), cube=(model.workspace_center, model.workspace_size))
        case ContactConfig(model=model):
            x, y, _ = model.workspace_center
            return Trained(model.spacing, (x, y, 0.0))
        case _:
            name = architecture_of(config).name
            raise UsageError(f"Frames of your own need weights of obpose or obpose-contact; those given are of {name}.")


@dataclass(frozen=True, eq=False)
class PreparedFrames:
    """Frames as model input, and notes for the user on how they compare to the training."""

    recording: Recording
    """The frames in full resolution."""
    observation: Observation
    """A batch of one clip with one pixel of each square of `every` x `every`; pixels outside the workspace are not
    valid."""
    pose: Pose
    """world_from_camera."""
    workspace: Workspace
    every: int
    world: str
    """Note on the origin of the world frame."""
    resolution: str
    """Note on the pixel spacing."""

    def points(self, frame: int) -> Float64[np.ndarray, "height width 3"]:
        """Unproject a frame in full resolution, world frame, metres."""
        return unproject(self.recording.depth[frame], self.recording.k, self.pose)


def prepare_frames(frames: Frames, trained: Trained) -> PreparedFrames:
    """Read frames, find the table, and choose the resolution for a model.

    Raises:
        UsageError: flags or files are missing or wrong, contradict each other, hold no depth, or show no table.
        CorruptFile: a file cannot be read.
    """
    recording = _read(frames)
    given = None if frames.camera_pose is None else read_pose(frames.camera_pose)
    first = recording.depth[0] > 0
    if not first.any():
        raise UsageError(
            "The first frame has no depth, and objects are looked for there: leave out its image and its depth."
        )
    points = unproject(recording.depth[0], recording.k, np.eye(4))[first]
    pose = pose_over_table(points, center=trained.center) if given is None else given
    world = FITTED if given is None else world_note(points @ pose[:3, :3].T, pose[:3, 3])
    points = points @ pose[:3, :3].T + pose[:3, 3]
    try:
        workspace = find_workspace(points)
    except UsageError as error:
        raise error if given is None else UsageError(f"{error} World: {world}.") from None
    if frames.workspace is not None:
        workspace = rectangle(_corners(frames.workspace), workspace.floor)
    whole = observe(replace(recording, rgb=recording.rgb[:1], depth=recording.depth[:1]), pose, workspace, trained)
    spacing = surface_spacing(whole)
    if spacing is None:
        raise UsageError(
            "The workspace shows no points in the first frame; give another --workspace or --depth-max, or move the "
            "origin of --camera-pose to the middle of the table."
        )
    every = frames.every or _step(spacing, trained.spacing, recording)
    observation = observe(recording.every(every), pose, workspace, trained)
    note = _resolution_note(observation, every, trained)
    return PreparedFrames(recording, observation, pose, workspace, every, world, note)


def _read(frames: Frames) -> Recording:
    if not 0 < frames.depth_scale < math.inf:
        raise UsageError(f"--depth-scale is {frames.depth_scale:g}; expected more than 0, and finite.")
    if frames.every is not None and frames.every < 1:
        raise UsageError(f"--every {frames.every}: expected 1 or a little more.")
    if frames.depth_max is not None and not frames.depth_max > 0:
        raise UsageError(f"--depth-max is {frames.depth_max:g}; expected metres, more than 0.")
    k = parse_intrinsics(frames.intrinsics)
    recording = read_recording(frames.rgb, frames.depth, k, depth_scale=frames.depth_scale)
    if frames.euclidean:
        recording = recording.planar()
    if frames.depth_max is not None:
        recording = replace(recording, depth=np.where(recording.depth > frames.depth_max, 0, recording.depth))
    if frames.every is not None:
        recording.every(frames.every)  # raises an error if the images are too small
    return recording


def _corners(text: str) -> tuple[float, float, float, float]:
    try:
        x0, x1, y0, y1 = (float(part) for part in text.split(","))
    except ValueError:
        x0, x1, y0, y1 = (math.nan,) * 4
    if not (x0 < x1 and y0 < y1 and np.isfinite([x0, x1, y0, y1]).all()):
        raise UsageError(f"--workspace {text}: expected x0,x1,y0,y1 in metres with x0 < x1 and y0 < y1.")
    return x0, x1, y0, y1


def _step(spacing: float, trained: float, recording: Recording) -> int:
    """Side of the squares of pixels whose spacing comes nearest to the training."""
    most = max(1, min(recording.depth.shape[1:]) // _LEAST_EDGE)
    return min(max(1, round(trained / spacing)), most)


def observe(recording: Recording, pose: Pose, workspace: Workspace, trained: Trained) -> Observation:
    """Give the frames as a batch of one clip; pixels outside of the workspace have no depth."""
    depth = recording.depth.copy()
    for frame in depth:
        points = unproject(frame, recording.k, pose)
        outside = ~workspace.holds(points)
        if trained.cube is not None:
            center, edge = trained.cube
            outside |= (np.abs(points - np.array(center)) > edge / 2).any(axis=-1)
        frame[outside] = 0
    batch = rearrange(torch.from_numpy(depth), "frame h w -> 1 frame 1 h w")
    return Observation(
        rgb=rearrange(torch.from_numpy(recording.rgb), "frame h w c -> 1 frame 1 h w c").to(torch.float32) / 255,
        depth=batch,
        valid=batch > 0,
        k=torch.from_numpy(recording.k).to(torch.float32)[None, None],
        world_from_camera=torch.from_numpy(pose).to(torch.float32)[None, None],
    )


def world_note(points: Float64[np.ndarray, "point 3"], camera: Float64[np.ndarray, "3"]) -> str:
    """Describe whether the table is level at z = 0 in a given world frame.

    Args:
        points: Relative to the camera, with the axes of the world, metres.
        camera: World frame, metres.
    """
    plane = find_table(points)
    if plane is None:
        return GIVEN
    tilt = math.degrees(math.acos(min(1.0, abs(float(plane.normal[2])))))
    height = float(np.median(table_points(points, plane)[:, 2]) + camera[2])
    fault = ""
    if tilt > _MOST_TILT:
        fault = f"the table in view is tilted by {tilt:.0f} degrees: let the world's z axis point up from the table"
    elif abs(height) > _MOST_HEIGHT:
        fault = f"the table in view lies at z = {height:.2f} m: move the world's origin onto the table"
    return f"{GIVEN}; {fault}; results may be poor" if fault else GIVEN


def _resolution_note(observation: Observation, every: int, trained: Trained) -> str:
    """Compare the pixel spacing to the training."""
    height, width = observation.depth.shape[-2:]
    spacing = surface_spacing(observation)
    if spacing is None:
        return f"{width}x{height} pixels (--every {every}); no neighbouring pixels have a depth"
    note = (
        f"{width}x{height} pixels (--every {every}); neighbouring pixels are {1000 * spacing:.1f} mm apart on the "
        f"surfaces, {'in training' if trained.learned else 'recommended'} {1000 * trained.spacing:.1f} mm"
    )
    return f"{note}; is --depth-scale right?" if spacing > _COARSE * trained.spacing * every else note
