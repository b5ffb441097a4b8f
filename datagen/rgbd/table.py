"""The table of a recording, and the world frame that stands on it."""

import numpy as np
from jaxtyping import Float, Float64

from datagen.errors import NoTable
from datagen.rgbd.camera_pose import Pose
from datagen.rgbd.plane import FEWEST_POINTS, SAMPLE, TOLERANCE, Plane, fit_plane, refine_plane

PLANES = 4
"""Number of candidate planes."""
WIDTH = 0.6
"""Square root of a table's visible area in metres; smaller planes are less likely a table."""
_NEAREST, _QUANTILE = 0.5, 0.25
"""Distances below this share of this quantile count as equal, so that objects right before the lens do not dominate."""
_LEAST_DISTANCE = 1e-3
"""Smallest such distance, metres."""
_AROUND = 0.15
"""Radius in metres of the surroundings of a given point to which the table's plane is fitted first."""
_LEVEL, _UPRIGHT = 0.94, 0.35
"""Least cosine between the normal of a table and the vertical (20 degrees), and greatest one for that of a wall."""
_DOWNWARDS, _SIDEWAYS = 0.14, 0.85
"""Least parts of the normal of a wall that point downwards (8 degrees) and sideways in an upright image."""
_RISE, _LEAST_FLOOR, _BEFORE = 0.5, 0.05, 0.95
"""A wall's normal points upwards in the image by so much less than that of the floor before it; least share of the
points on that floor; least share of the points of each plane that are before the other one."""


def find_table(
    points: Float[np.ndarray, "point 3"],
    *,
    up: Float[np.ndarray, "3"] | None = None,
    near: Float[np.ndarray, "3"] | None = None,
) -> Plane | None:
    """Find the plane that is most likely the table, with its normal towards the camera; None if there is no plane.

    Each candidate scores the number of its points, weighted by inverse cubed distance from the camera, times the cube
    of its width up to `WIDTH`. So a table beats a wall at twice its distance, even if the wall fills more pixels, and
    it beats the side of a box. A wall that has a level plane before its foot is not the table, however large it is.

    Args:
        points: Camera frame (x right, y down, z forward), metres; the image is upright unless `up` is given.
        up: Direction of the world's z axis in the camera frame, if known; the table is level then.
        near: A point on the table, if known.
    """
    if not len(points):
        return None
    rng = np.random.default_rng(0)
    sample = _near_sample(points, rng)
    if near is not None:
        local = points[np.linalg.norm(points - near, axis=1) < _AROUND]
        found = fit_plane(local, rng)
        return None if found is None else refine_plane(found, sample).oriented_towards(np.zeros((1, 3)))
    planes = [plane.oriented_towards(np.zeros((1, 3))) for plane in _planes(sample, rng)]
    if up is not None:
        planes = [plane for plane in planes if plane.normal @ up > _LEVEL]
    best = max(planes, key=lambda plane: _score(plane, sample), default=None)
    if best is None or up is not None:
        return best
    floors = [plane for plane in planes if _stands_on(best, plane, sample)]
    return max(floors, key=lambda plane: _score(plane, sample), default=best)


def is_wall(plane: Plane) -> bool:
    """Whether the plane cannot be a table in an upright image: its normal points downwards or sideways there."""
    x, y, _ = plane.normal
    return bool(y > _DOWNWARDS or abs(x) > _SIDEWAYS)


def _stands_on(wall: Plane, floor: Plane, sample: Float[np.ndarray, "point 3"]) -> bool:
    """Whether a plane that faces the camera is a wall that stands on another one.

    Seen from straight above, the side of a box is upright beside the table, too. But then parts of the table are
    behind that side, and a floor has all of its wall above it.
    """
    rise = wall.normal[1] - floor.normal[1]
    on_wall, on_floor = (table_points(sample, plane) for plane in (wall, floor))
    if abs(wall.normal @ floor.normal) > _UPRIGHT or rise < _RISE or len(on_floor) < _LEAST_FLOOR * len(sample):
        return False
    both = np.concatenate([floor.height(on_wall), wall.height(on_floor)])
    return bool(np.mean(both > -2 * TOLERANCE) > _BEFORE)


def table_points(points: Float[np.ndarray, "point 3"], plane: Plane) -> Float[np.ndarray, "some 3"]:
    """Select the points on a plane."""
    return points[np.abs(plane.height(points)) < TOLERANCE]


def pose_over_table(
    points: Float[np.ndarray, "point 3"],
    *,
    center: tuple[float, float, float] = (0.0, 0.0, 0.0),
    plane: Plane | None = None,
) -> Pose:
    """Find world_from_camera of a world in which the table is z = 0 and x points horizontally towards the camera.

    Points are in the camera frame, metres. The median of the table's points gets x and y of `center`, world frame.
    `plane` is the table, which is looked for otherwise.

    Raises:
        NoTable: no plane is found.
    """
    plane = find_table(points) if plane is None else plane
    if plane is None:
        raise NoTable(
            "No plane was found, so that up is unknown; expected a table in view, and depth in the right unit "
            "(--depth-scale)."
        )
    middle = np.median(table_points(points, plane), axis=0)
    rotation = _axes(plane, middle)
    x, y, _ = rotation @ middle
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = [center[0] - x, center[1] - y, -plane.offset]
    return pose


def _near_sample(points: Float[np.ndarray, "point 3"], rng: np.random.Generator) -> Float[np.ndarray, "sample 3"]:
    """Draw points with probabilities proportional to their inverse cubed distance."""
    distance = np.linalg.norm(points, axis=1)
    nearest = max(_NEAREST * np.quantile(distance, _QUANTILE), _LEAST_DISTANCE)
    weight = np.maximum(distance, nearest) ** -3.0
    return points[rng.choice(len(points), 2 * SAMPLE, p=weight / weight.sum())]


def _planes(points: Float[np.ndarray, "point 3"], rng: np.random.Generator) -> list[Plane]:
    """Find the largest plane, then the largest plane of the other points, and so on."""
    found: list[Plane] = []
    while len(found) < PLANES and len(points) >= FEWEST_POINTS:
        plane = fit_plane(points, rng)
        if plane is None:
            break
        found.append(plane)
        points = points[np.abs(plane.height(points)) > 2 * TOLERANCE]
    return found


def _score(plane: Plane, sample: Float[np.ndarray, "point 3"]) -> float:
    on_plane = table_points(sample, plane)
    if len(on_plane) < 3:
        return 0.0
    # The two larger variances are those along the plane. A uniform distribution of side a has variance a^2 / 12, so
    # the fourth root of 12^2 times their product is the square root of the area.
    _, short, long = np.maximum(np.linalg.eigvalsh(np.cov(on_plane.T)), 0.0)
    width = float(np.sqrt(12 * np.sqrt(short * long)))
    return len(on_plane) * min(1.0, width / WIDTH) ** 3


def _axes(plane: Plane, middle: Float[np.ndarray, "3"]) -> Float64[np.ndarray, "3 3"]:
    """World axes as rows, in the camera frame: x from the table's middle towards the camera, z along the normal."""
    z = plane.normal
    towards = -middle
    x = towards - z * (z @ towards)
    if np.linalg.norm(x) < 0.1 * np.linalg.norm(towards):
        # From straight above x is undefined; use the direction to the lower side of the image.
        x = np.array([0.0, 1.0, 0.0])
        x = x - z * (z @ x)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])
