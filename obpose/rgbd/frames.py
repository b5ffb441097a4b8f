"""RGB-D frames of a user as model input: world frame, table, and resolution."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Float64

from datagen.geometry import unproject
from obpose.config import Config
from obpose.contact.config import ContactConfig
from obpose.errors import NoTable, UsageError
from obpose.model.resolution import TOLERANCE, surface_spacing
from obpose.rgbd.frame_arguments import Frames
from obpose.rgbd.reading import parse_pixel, parse_rectangle
from obpose.rgbd.recording import Recording
from obpose.rgbd.workspace import UNSUPPORTED, Workspace, doubts, find_workspace, rectangle
from obpose.rgbd.world import World, choose_world, table_clouds, table_frames
from obpose.systems import architecture_of
from obpose.trainable import Configuration
from obpose.types import Observation

_COARSE = 5.0
"""Pixel spacing relative to the training above which the unit of depth is most likely wrong."""
_LEAST_EDGE = 24
"""Least height and width in pixels of the images that a model gets, unless the frames are smaller."""
_OFF_CENTRE = 0.2
"""Distance of the principal point from the middle, in image sides, above which the intrinsics are most likely those of
images of another size: half or double the size gives 0.25 or 0.5."""
_LEAST_PICKED = 0.5
"""Least share of the picked pixels with a depth, relative to that of all pixels."""
_NEAREST_MEDIAN = 0.2
"""Median depth in metres below which the unit of depth is most likely wrong."""
_STILL = 2e-3
"""Largest difference between poses, metres and radians, that counts as a static camera."""


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
            raise UsageError(
                f"Weights of {name} cannot segment your own frames; expected those of another system, such as "
                "contact-masks."
            )


@dataclass(frozen=True, eq=False)
class PreparedFrames:
    """Frames as model input, and notes for the user on how they compare to the training."""

    recording: Recording
    """The frames in full resolution."""
    observation: Observation
    """A batch of one clip with one pixel of each square of `every` x `every`; pixels outside the workspace are not
    valid. If the camera moves, its pose is that of the first frame."""
    world: World
    workspace: Workspace
    every: int
    resolution: str
    """Note on the pixel spacing."""
    warnings: tuple[str, ...] = ()
    """Reasons why the results may be wrong."""

    @property
    def moves(self) -> bool:
        """Whether the camera moves."""
        return bool(np.abs(self.world.poses - self.world.poses[0]).max() > _STILL)

    def points(self, frame: int) -> Float64[np.ndarray, "height width 3"]:
        """Unproject a frame in full resolution, world frame, metres."""
        return unproject(self.recording.depth[frame], self.recording.k, self.world.poses[frame])

    def still(self, frame: int) -> Observation:
        """Give one frame as a batch of one clip, with its own pose of the camera."""
        clip, pick = self.observation, slice(frame, frame + 1)
        pose = torch.from_numpy(self.world.poses[frame]).to(torch.float32)[None, None]
        images = {name: getattr(clip, name)[:, pick] for name in ("rgb", "depth", "valid")}
        return replace(clip, **images, world_from_camera=pose)


def prepare(recording: Recording, frames: Frames, trained: Trained) -> PreparedFrames:
    """Find the table of a recording, and choose the resolution for a model, as the flags `frames` say.

    Raises:
        UsageError: flags are wrong.
        NoTable: the frames show no table, or nothing within the workspace.
    """
    # World and workspace.
    table = None if frames.table is None else parse_pixel(frames.table)
    world = choose_world(recording, table, trained.center)
    shown = table_frames(recording)
    clouds = table_clouds(recording, world.poses)
    workspace = find_workspace(np.concatenate(clouds), world.table)
    seen = () if world.table is not None else doubts(clouds[0], workspace, world.poses[shown[0], :3, 3])
    warnings = (*world.warnings, *seen, UNSUPPORTED) if (*world.warnings, *seen) else ()
    if frames.workspace is not None:
        workspace = rectangle(parse_rectangle(frames.workspace), workspace.floor)
    # Resolution with point distances as in training.
    some = replace(recording, rgb=recording.rgb[shown], depth=recording.depth[shown], poses=None)
    spacing = surface_spacing(observe(some, world.poses[shown], workspace, trained))
    if spacing is None:
        raise NoTable(
            "The workspace shows no points; give another --workspace or --depth-max, or the table with --table."
        )
    every = frames.every or _step(spacing, trained.spacing, recording)
    reduced = recording.every(every)
    observation = observe(reduced, world.poses, workspace, trained)
    warnings = (
        *_lens_doubts(recording),
        *_unit_doubts(recording),
        *warnings,
        *_holes(recording, reduced, every),
        *_too_coarse(observation, every, trained),
    )
    note = _resolution_note(observation, every, trained)
    return PreparedFrames(recording, observation, world, workspace, every, note, warnings)


def _lens_doubts(recording: Recording) -> tuple[str, ...]:
    """Say why the intrinsics are probably those of images of another size."""
    height, width = recording.depth.shape[1:]
    cx, cy = recording.k[:2, 2]
    if max(abs(cx / width - 0.5), abs(cy / height - 0.5)) <= _OFF_CENTRE:
        return ()
    return (
        f"The principal point {cx:g}, {cy:g} is far from the middle of the {width}x{height} images. If the images were "
        "resized, scale fx, fy, cx and cy alike.",
    )


def _unit_doubts(recording: Recording) -> tuple[str, ...]:
    """Say that the scene is nearer than most depth cameras measure."""
    median = float(np.median(recording.depth[recording.depth > 0]))
    if median >= _NEAREST_MEDIAN:
        return ()
    return (
        f"The median depth is {median:.2g} m, nearer than most depth cameras measure. Check the metres per unit, "
        "--depth-scale or depth_scale in camera.json.",
    )


def _holes(recording: Recording, reduced: Recording, every: int) -> tuple[str, ...]:
    """Say that the picked pixels miss depth much more often than all pixels."""
    picked, known = (float(np.mean(each.depth > 0)) for each in (reduced, recording))
    if picked >= _LEAST_PICKED * known:
        return ()
    return (
        f"Only {100 * picked:.0f} % of the pixels that --every {every} picks have a depth, and {100 * known:.0f} % of "
        "all: missing depth forms a grid. Give another --every.",
    )


def _too_coarse(observation: Observation, every: int, trained: Trained) -> tuple[str, ...]:
    """Say that neighbouring pixels are farther apart than in training, and no smaller `every` can change it."""
    spacing = surface_spacing(observation)
    if not trained.learned or every > 1 or spacing is None or spacing <= TOLERANCE * trained.spacing:
        return ()
    return (
        f"Neighbouring pixels are {spacing / trained.spacing:.1f} times as far apart as in training: small objects may "
        "be missed. Take images of a higher resolution, or from nearer.",
    )


def _step(spacing: float, trained: float, recording: Recording) -> int:
    """Side of the squares of pixels whose spacing comes nearest to the training."""
    most = max(1, min(recording.depth.shape[1:]) // _LEAST_EDGE)
    return min(max(1, round(trained / spacing)), most)


def observe(
    recording: Recording, poses: Float64[np.ndarray, "frame 4 4"], workspace: Workspace, trained: Trained
) -> Observation:
    """Give the frames as a batch of one clip; pixels outside of the workspace have no depth."""
    depth = recording.depth.copy()
    for frame, pose in zip(depth, poses, strict=False):
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
        world_from_camera=torch.from_numpy(poses[0]).to(torch.float32)[None, None],
    )


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
    return f"{note}; check --depth-scale" if spacing > _COARSE * trained.spacing * every else note
