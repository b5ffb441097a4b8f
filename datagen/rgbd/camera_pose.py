"""Camera poses from files of the user."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from datagen.errors import CorruptFile, UsageError
from datagen.storage.safe_io import npy_shape, parse_json, read_npy, read_text

Pose = Float64[np.ndarray, "4 4"]
"""Rigid transform, metres."""

MOST_POSE_BYTES = 2**16
"""Largest size of a pose file, bytes."""
MOST_TRANSLATION = 1000.0
"""Largest coordinate of the camera in metres; larger ones indicate wrong units."""


class _Unreadable(ValueError):
    """A file that holds no numbers in rows."""


def read_pose(path: Path, flag: str = "--camera-pose ") -> Pose:
    """Read world_from_camera: four rows of four numbers as text, JSON or NPY; `flag` precedes the path in messages.

    Raises:
        UsageError: there is no such file, or it holds no rigid pose.
        CorruptFile: it cannot be read.
    """
    try:
        pose = _READERS.get(path.suffix.lower(), _read_rows)(path)
    except FileNotFoundError:
        raise UsageError(f"{flag}{path} does not exist.") from None
    except _Unreadable as error:
        raise CorruptFile(f"{flag}{path} cannot be read ({error}); expected four rows of four numbers.") from None
    check_pose(pose, f"{flag}{path}")
    assert pose is not None
    return pose


def check_pose(pose: Pose | None, name: str) -> None:
    """Check that a matrix is a rigid pose in metres; `name` names it in messages.

    Raises:
        UsageError: it is not.
    """
    if pose is None or not is_rigid(pose):
        raise UsageError(
            f"{name} holds no rigid pose; expected world_from_camera: 4x4, a rotation and a translation "
            "in metres over the row 0 0 0 1, camera axes x right, y down, z forward."
        )
    if np.abs(pose[:3, 3]).max() > MOST_TRANSLATION:
        raise UsageError(
            f"{name} has the translation {', '.join(f'{value:g}' for value in pose[:3, 3])}; expected "
            f"metres, at most {MOST_TRANSLATION:,.0f}. Move the world's origin onto the table."
        )


def _read_rows(path: Path) -> Pose | None:
    """Read numbers separated by spaces or commas; `#` starts a comment."""
    lines = (line.partition("#")[0].replace(",", " ").split() for line in read_text(path, MOST_POSE_BYTES).splitlines())
    try:
        return pose_matrix([[float(number) for number in line] for line in lines if line])
    except ValueError as error:
        raise _Unreadable(" ".join(str(error).split())[:100]) from None


def _read_json(path: Path) -> Pose | None:
    try:
        return pose_matrix(parse_json(read_text(path, MOST_POSE_BYTES)))
    except ValueError as error:
        raise _Unreadable(" ".join(str(error).split())[:100]) from None


def _read_array(path: Path) -> Pose | None:
    shape, dtype = npy_shape(path)
    if shape != (4, 4) or dtype.kind not in "uif":
        return None
    with np.errstate(over="ignore"):
        return read_npy(path).astype(np.float64)


_READERS = {".json": _read_json, ".npy": _read_array}
"""Readers by file ending; other files are text."""


def pose_matrix(value: Any) -> Pose | None:
    """Convert four lists of four numbers to an array; None for anything else."""
    if not isinstance(value, list) or not all(isinstance(row, list) and len(row) == 4 for row in value):
        return None
    numbers = [number for row in value for number in row]
    if len(numbers) != 16 or not all(type(number) in (int, float) for number in numbers):
        return None
    return np.array([float(number) if abs(number) < 1e300 else np.inf for number in numbers]).reshape(4, 4)


def is_rigid(pose: Pose) -> bool:
    """Whether all numbers are finite, and the matrix consists of a rotation and a translation."""
    rotation = pose[:3, :3]
    if not np.isfinite(pose).all() or np.abs(rotation).max() > 2:
        return False
    orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
    return bool(orthonormal and np.allclose(pose[3], [0, 0, 0, 1], atol=1e-6))
