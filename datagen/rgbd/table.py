"""The table of a recording, and the world frame that stands on it."""

import numpy as np
from jaxtyping import Float, Float64

from datagen.errors import UsageError
from datagen.rgbd.camera_pose import Pose
from datagen.rgbd.plane import FEWEST_POINTS, SAMPLE, TOLERANCE, Plane, fit_plane

PLANES = 4
"""Number of candidate planes."""
WIDTH = 0.6
"""Square root of a table's visible area in metres; smaller planes are less likely a table."""
_NEAREST, _QUANTILE = 0.5, 0.25
"""Distances below this share of this quantile count as equal, so that objects right before the lens do not dominate."""
_LEAST_DISTANCE = 1e-3
"""Smallest such distance, metres."""


def find_table(points: Float[np.ndarray, "point 3"], *, seed: int = 0) -> Plane | None:
    """Find the plane that is most likely the table, with its normal towards the camera; None if there is no plane.

    Each candidate scores the number of its points, weighted by inverse cubed distance from the camera, times the cube
    of its width up to `WIDTH`. So a table beats a wall at twice its distance, even if the wall fills more pixels, and
    it beats the side of a box.

    Points are in the camera frame, metres.
    """
    if not len(points):
        return None
    rng = np.random.default_rng(seed)
    sample = _near_sample(points, rng)
    best = max(_planes(sample, rng), key=lambda plane: _score(plane, sample), default=None)
    return None if best is None else best.oriented_towards(np.zeros((1, 3)))


def table_points(points: Float[np.ndarray, "point 3"], plane: Plane) -> Float[np.ndarray, "some 3"]:
    """Select the points on a plane."""
    return points[np.abs(plane.height(points)) < TOLERANCE]


def pose_over_table(
    points: Float[np.ndarray, "point 3"],
    *,
    center: tuple[float, float, float] = (0.0, 0.0, 0.0),
    seed: int = 0,
    advice: str = "give --camera-pose",
) -> Pose:
    """Find world_from_camera of a world in which the table is z = 0 and x points horizontally towards the camera.

    Points are in the camera frame, metres. The median of the table's points gets x and y of `center`, world frame.
    `advice` ends the message about a missing plane.

    Raises:
        UsageError: no plane is found.
    """
    plane = find_table(points, seed=seed)
    if plane is None:
        raise UsageError(f"No plane was found in the first frame, so that up is unknown; {advice}.")
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
