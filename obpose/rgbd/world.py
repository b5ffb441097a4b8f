"""The world of a recording, which stands on the table, and the cameras' poses in it."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int

from datagen.geometry import invert_rigid, transform, unproject
from datagen.rgbd.plane import Plane
from datagen.rgbd.table import find_table, is_wall, pose_over_table, table_points
from obpose.errors import NoTable, UsageError
from obpose.rgbd.recording import Recording

GIVEN = "as given by the camera's pose"
FITTED = (
    "stands on the table: z = 0 is its plane and z points up, x points horizontally towards the camera, and the median "
    "of the plane's points is {middle}. The table is {reason}"
)
FOUND = "the largest plane near the camera"
TABLE_FRAMES = 5
"""Number of frames, evenly spread, in which the table is looked for."""
_MOST_POINTS = 400_000
"""Points of a frame that are used to find the table."""
_MOST_TILT, _MOST_HEIGHT, _MOST_DISTANCE = 10.0, 0.02, 0.5
"""Largest tilt in degrees, height and distance from the middle in metres of the table in a given world. Models expect
objects to stand on z = 0 and ignore everything below."""
WALL = "The largest plane faces down or sideways in the image, as a wall does."


@dataclass(frozen=True, eq=False)
class World:
    """World frame, and the camera in it."""

    poses: Float64[np.ndarray, "frame 4 4"]
    """world_from_camera."""
    note: str
    """Origin and axes."""
    warnings: tuple[str, ...] = ()
    table: Float64[np.ndarray, "2"] | None = None
    """Place on the table that the user named, metres."""

    @property
    def camera(self) -> str:
        """Describe the place of the camera in the first frame."""
        pose = self.poses[0]
        angle = math.degrees(math.asin(min(1.0, max(-1.0, -float(pose[2, 2])))))
        return f"{pose[2, 3]:.2f} m above the table, looking down by {angle:.0f} degrees"


def choose_world(recording: Recording, table: tuple[int, int] | None, center: tuple[float, float, float]) -> World:
    """Keep the world of given poses if the table is at z = 0 there; otherwise, put the world on the table.

    Args:
        recording: Frames, and poses if they are known.
        table: Column and row of a pixel of the first frame that shows the table; None to find it.
        center: Middle of the table in the world of the training, metres.

    Raises:
        UsageError: the pixel is outside of the images, or the first frame has no depth.
        NoTable: no plane is found.
    """
    if not (recording.depth > 0).any():
        raise NoTable("No frame has a depth nearer than --depth-max; expected a table in view.")
    # Points of the table in the first camera.
    given, frames = recording.poses, len(recording.depth)
    relative = np.tile(np.eye(4), (frames, 1, 1)) if given is None else invert_rigid(given[0]) @ given
    points = np.concatenate(table_clouds(recording, relative))
    # Plane: that of the named pixel, one that is level by the given poses, or any.
    named = None if table is None else _point(unproject(recording.depth[0], recording.k, np.eye(4)), table)
    if named is not None:
        plane, reason = find_table(points, near=named), "that of the pixel --table"
        if table is not None and plane is None:
            raise NoTable(f"--table {table[0]},{table[1]}: there is no plane around this pixel; name another one.")
        if given is not None and plane is not None and not _fault(points, plane, given[0], center):
            return World(given, GIVEN, table=transform(given[0], named)[:2])
    elif given is not None:
        plane, reason = find_table(points, up=given[0, 2, :3]), FOUND
        if plane is None:
            plane, fault = find_table(points), "no level plane is in view"
        else:
            fault = _fault(points, plane, given[0], center)
        if not fault:
            return World(given, GIVEN)
        reason = f"{FOUND}. It is not that of the given poses, where {fault}: they only tell how the camera moves"
    else:
        plane, reason = find_table(points), FOUND
    # Camera pose over that plane.
    fitted = pose_over_table(points, center=center, plane=plane)
    warnings = (WALL,) if plane is not None and given is None and named is None and is_wall(plane) else ()
    place = None if named is None else transform(fitted, named)[:2]
    x, y, _ = center
    middle = f"at x = {x:.3f} m, y = {y:.3f} m, as in training" if x or y else "the origin"
    return World(fitted @ relative, FITTED.format(middle=middle, reason=reason), warnings, place)


def table_frames(recording: Recording) -> Int[np.ndarray, "some"]:
    """Choose the frames in which the table is looked for: evenly spread ones that have a depth."""
    seen = np.flatnonzero((recording.depth > 0).any(axis=(1, 2)))
    return seen[np.unique(np.linspace(0, len(seen) - 1, TABLE_FRAMES).round().astype(int))]


def table_clouds(recording: Recording, poses: Float64[np.ndarray, "frame 4 4"]) -> list[Float64[np.ndarray, "point 3"]]:
    """Unproject these frames into the frame of reference of the poses, metres."""
    clouds = []
    for frame in table_frames(recording):
        depth = recording.depth[frame]
        points = unproject(depth, recording.k, poses[frame])[depth > 0]
        clouds.append(points[:: 1 + len(points) // _MOST_POINTS])
    return clouds


def _point(surface: Float64[np.ndarray, "height width 3"], pixel: tuple[int, int]) -> Float64[np.ndarray, "3"]:
    """Find the surface point of a pixel, or of the nearest one around it that has a depth."""
    column, row = pixel
    height, width = surface.shape[:2]
    if not (0 <= column < width and 0 <= row < height):
        raise UsageError(f"--table {column},{row}: expected column and row of a pixel of the {width}x{height} images.")
    rows, columns = np.nonzero(surface[..., 2] > 0)
    if not len(rows):
        raise UsageError("The first frame has no depth, so that --table names no point; leave it out.")
    nearest = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
    return surface[rows[nearest], columns[nearest]]


def _fault(
    points: Float64[np.ndarray, "point 3"],
    plane: Plane,
    pose: Float64[np.ndarray, "4 4"],
    center: tuple[float, float, float],
) -> str:
    """Describe why models cannot use a world, from the table in the camera frame; empty if they can."""
    tilt = math.degrees(math.acos(min(1.0, abs(float(pose[2, :3] @ plane.normal)))))
    x, y, height = np.median(table_points(points, plane) @ pose[:3, :3].T + pose[:3, 3], axis=0)
    distance = math.hypot(x - center[0], y - center[1])
    if tilt > _MOST_TILT:
        return f"the table is tilted by {tilt:.0f} degrees"
    if abs(height) > _MOST_HEIGHT:
        return f"the table lies at z = {height:.2f} m"
    return f"the table is {distance:.1f} m from the origin" if distance > _MOST_DISTANCE else ""
