"""The world frame of a recording: the user's own, or one that stands on the largest plane in view."""

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64

from obpose.errors import CorruptFile, UsageError
from obpose.measure import TAIL
from obpose.plane import Plane, fit_plane

Pose = Float64[np.ndarray, "4 4"]

GIVEN = "as given with --camera-pose"
FITTED = (
    "stands on the largest plane in the first frame: z = 0 is the plane and z points up, x points horizontally towards "
    "the camera, and the origin lies such that the points in view surround the place that the model knows"
)


def read_pose(path: Path) -> Pose:
    """world_from_camera of a file: four rows of four numbers as text, JSON or NPY.

    Raises:
        UsageError: there is no such file, or it holds no rigid pose.
        CorruptFile: it cannot be read.
    """
    try:
        if path.suffix == ".npy":
            # A file of several arrays that has this ending becomes an object, which the line below refuses.
            pose = np.array(np.load(path, allow_pickle=False))
        else:
            text = path.read_text()
            pose = np.array(json.loads(text) if path.suffix == ".json" else _rows(text))
        pose = pose.astype(np.float64)
    except FileNotFoundError:
        raise UsageError(f"--camera-pose {path} does not exist.") from None
    except (OSError, ValueError, TypeError, EOFError) as error:
        raise CorruptFile(
            f"--camera-pose {path} cannot be read ({error}); expected four rows of four numbers."
        ) from None
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or not _is_rigid(pose):
        raise UsageError(
            f"--camera-pose {path} holds no rigid pose; expected world_from_camera: 4x4, a rotation and a translation "
            "in metres over the row 0 0 0 1, camera axes x right, y down, z forward."
        )
    return pose


def pose_over_plane(points: Float[np.ndarray, "point 3"], *, center: tuple[float, float, float], seed: int = 0) -> Pose:
    """world_from_camera in the frame that `FITTED` describes.

    Args:
        points: What the camera saw, camera frame, metres.
        center: Where the middle of the points in view is to be; of this x and y count.
        seed: Of the search for the plane.

    Raises:
        UsageError: no plane is found.
    """
    plane = fit_plane(points, np.random.default_rng(seed))
    if plane is None:
        raise UsageError("No plane was found in the first frame, so that up is unknown; give --camera-pose.")
    plane = plane.oriented_towards(np.zeros((1, 3)))
    rotation = _axes(plane, points)
    middle = middle_of(points @ rotation.T)
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = [center[0] - middle[0], center[1] - middle[1], -plane.offset]
    return pose


def middle_of(points: Float[np.ndarray, "point 3"]) -> Float64[np.ndarray, "3"]:
    """Middle of what was seen, as `obpose.measure` finds it in training clips."""
    return (np.quantile(points, TAIL, axis=0) + np.quantile(points, 1 - TAIL, axis=0)) / 2


def _rows(text: str) -> list[list[float]]:
    """Numbers between spaces or commas; `#` begins a comment."""
    lines = (line.partition("#")[0].replace(",", " ").split() for line in text.splitlines())
    return [[float(number) for number in line] for line in lines if line]


def _axes(plane: Plane, points: Float[np.ndarray, "point 3"]) -> Float64[np.ndarray, "3 3"]:
    """World axes as rows, in the camera's frame: x towards the camera, z away from the plane."""
    z = plane.normal
    towards = -np.median(points, axis=0)
    x = towards - z * (z @ towards)
    if np.linalg.norm(x) < 0.1 * np.linalg.norm(towards):
        # Seen from straight above there is no such direction: the lower side of the image is near.
        x = np.array([0.0, 1.0, 0.0])
        x = x - z * (z @ x)
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def _is_rigid(pose: Pose) -> bool:
    rotation = pose[:3, :3]
    orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
    return bool(orthonormal and np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6))
