"""Cameras from a JSON file: image size, camera matrix and poses of every view.

{"convention": "opencv",
 "views": [{"width": 640, "height": 480, "fx": 600, "fy": 600, "cx": 320, "cy": 240,
            "world_from_camera": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1.2], [0, 0, 0, 1]]}]}

`K` may stand for fx, fy, cx and cy, and `camera_from_world` for `world_from_camera`. A list of matrices gives a pose
for each frame. With `"convention": "opengl"`, cameras look along -z and their y axis points up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from datagen.errors import UsageError
from datagen.geometry import invert_rigid, quaternion_from_rotation, rotation_from_quaternion
from datagen.recipe_rules import MOST_CAMERA_POSES
from datagen.scene import Camera, CameraPose, Lens, Vector
from datagen.storage.safe_io import read_json

LEAST_SIDE, MOST_SIDE = 8, 4096
"""Smallest and largest side of an image, pixels."""

MOST_VIEWS = 360

MOST_DISTANCE = 100.0
"""Largest coordinate of a camera's position, metres."""

RIGID = 1e-4
"""Largest deviation of a rotation's columns from orthonormal ones; they are made exact."""

_LENS = ("fx", "fy", "cx", "cy")
_KEYS = {"width", "height", "K", *_LENS, "world_from_camera", "camera_from_world"}
_DIGITS = 9
_AXES = {"opencv": np.eye(4), "opengl": np.diag([1.0, -1.0, -1.0, 1.0])}


@dataclass(frozen=True)
class CamerasFile:
    """Cameras that were read from a file."""

    path: Path
    resolution: tuple[int, int]
    """Width and height of the images, which all views share."""
    views: tuple[dict[str, Any], ...]
    """Plain values of each view: width, height, fx, fy, cx, cy and poses (position and quaternion)."""

    @property
    def frames(self) -> int:
        """Number of poses of the views that move, 1 if none does."""
        return max(len(view["poses"]) for view in self.views)

    def check_frames(self, frames: int) -> None:
        """Check that there is a pose for each frame, or one for all.

        Raises:
            UsageError: the clip has another number of frames.
        """
        if self.frames not in (1, frames):
            raise UsageError(
                f"{self.path} has {self.frames} poses for a view, but clips have {frames} frames. Give --frames "
                f"{self.frames}, or one pose for all frames."
            )


def read_cameras(path: Path) -> CamerasFile:
    """Read a cameras file.

    Raises:
        UsageError: there is no such file, or a view is incomplete or impossible.
        CorruptFile: the file is no JSON.
    """
    try:
        content = read_json(path)
    except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
        raise UsageError(f"--cameras {path}: there is no such file.") from None
    try:
        return _parse(path, content)
    except ValueError as error:
        raise UsageError(f"{path}: {error}. See docs/cameras_and_signals.md for an example.") from None


def cameras_from_values(views: Sequence[Mapping[str, Any]]) -> tuple[Camera, ...]:
    """Cameras of the plain values of `CamerasFile.views`."""
    return tuple(_camera(view) for view in views)


def _camera(view: Mapping[str, Any]) -> Camera:
    path = tuple(CameraPose(_vector(pose[:3]), (pose[3], pose[4], pose[5], pose[6])) for pose in view["poses"])
    forward = rotation_from_quaternion(np.array(path[0].quaternion_wxyz))[:, 2]
    return Camera(
        position=path[0].position,
        target=_vector(np.array(path[0].position) + forward),
        field_of_view=float(np.arctan(view["cx"] / view["fx"]) + np.arctan((view["width"] - view["cx"]) / view["fx"])),
        aspect=view["width"] / view["height"],
        lens=Lens(view["width"], view["height"], *(view[name] for name in _LENS)),
        path=path,
    )


def _vector(values: Sequence[float] | np.ndarray) -> Vector:
    x, y, z = (round(float(value), _DIGITS) for value in values)
    return x, y, z


def _parse(path: Path, content: Any) -> CamerasFile:
    if isinstance(content, list):
        content = {"views": content}
    if not isinstance(content, dict) or not isinstance(content.get("views"), list) or not content["views"]:
        raise ValueError('it holds no list of cameras; expected {"views": [...]}')
    if unknown := set(content) - {"convention", "views"}:
        raise ValueError(f"unknown key {min(unknown)!r:.40}; expected convention and views")
    convention = content.get("convention", "opencv")
    if convention not in _AXES:
        raise ValueError(f"convention is {convention!r:.40}; expected opencv or opengl")
    if len(content["views"]) > MOST_VIEWS:
        raise ValueError(f"it has {len(content['views'])} views; expected at most {MOST_VIEWS}")
    views = tuple(_view(f"view {number}", view, convention) for number, view in enumerate(content["views"]))
    sizes, counts = ({(view["width"], view["height"]) for view in views}, {len(view["poses"]) for view in views} - {1})
    if len(sizes) > 1:
        listed = ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
        raise ValueError(f"its views have images of different sizes ({listed}); make one dataset for each size")
    if len(counts) > 1:
        raise ValueError(f"its views have {', '.join(map(str, sorted(counts)))} poses; expected one or equally many")
    if (poses := max([1, *counts]) * len(views)) > MOST_CAMERA_POSES:
        raise ValueError(f"it has {poses:,} poses; expected at most {MOST_CAMERA_POSES:,}")
    return CamerasFile(path, next(iter(sizes)), views)


def _view(name: str, view: Any, convention: str) -> dict[str, Any]:
    if not isinstance(view, dict):
        raise ValueError(f"{name} is no object with keys")
    if unknown := set(view) - _KEYS:
        raise ValueError(
            f"{name} has the unknown key {min(unknown)!r:.40}; expected some of {', '.join(sorted(_KEYS))}"
        )
    size = {key: _side(f"{name}: {key}", view.get(key)) for key in ("width", "height")}
    return {**size, **_lens(name, view), "poses": _poses(name, view, convention)}


def _side(name: str, value: Any) -> int:
    if type(value) is not int or not LEAST_SIDE <= value <= MOST_SIDE:
        raise ValueError(f"{name} is {value!r:.40}; expected a whole number of pixels from {LEAST_SIDE} to {MOST_SIDE}")
    return value


def _lens(name: str, view: Mapping[str, Any]) -> dict[str, float]:
    if ("K" in view) == any(key in view for key in _LENS):
        raise ValueError(f"{name} needs either K or all of fx, fy, cx and cy")
    if "K" in view:
        k = _array(f"{name}: K", view["K"], (3, 3))
        if k[0, 1] or k[1, 0] or k[2].tolist() != [0, 0, 1]:
            raise ValueError(
                f"{name}: K has a skew or another last row than 0 0 1; expected [[fx 0 cx] [0 fy cy] [0 0 1]]"
            )
        lens = dict(zip(_LENS, (k[0, 0], k[1, 1], k[0, 2], k[1, 2]), strict=True))
    else:
        lens = {key: _array(f"{name}: {key}", view.get(key), ())[()] for key in _LENS}
    values = {key: float(value) for key, value in lens.items()}
    if wrong := [key for key in ("fx", "fy") if not 1 <= values[key] <= 1e6]:
        raise ValueError(
            f"{name}: {wrong[0]} is {values[wrong[0]]:g}; expected a focal length of 1 to 1,000,000 pixels. Flip the "
            "axes of the pose instead of the focal length's sign"
        )
    if wrong := [key for key in ("cx", "cy") if abs(values[key]) > 1e5]:
        raise ValueError(f"{name}: {wrong[0]} is {values[wrong[0]]:g}; expected a place near the image, pixels")
    return values


def _poses(name: str, view: Mapping[str, Any], convention: str) -> list[list[float]]:
    keys = [key for key in ("world_from_camera", "camera_from_world") if key in view]
    if len(keys) != 1:
        raise ValueError(f"{name} needs either world_from_camera or camera_from_world")
    key, value = keys[0], view[keys[0]]
    nested = isinstance(value, list) and value and isinstance(value[0], list) and value[0]
    several = bool(nested and isinstance(value[0][0], list))
    matrices = value if several else [value]
    return [_pose(f"{name}: {key}{f' of frame {i}' * several}", m, key, convention) for i, m in enumerate(matrices)]


def _pose(name: str, value: Any, key: str, convention: str) -> list[float]:
    if isinstance(value, list) and len(value) == 3:
        value = [*value, [0, 0, 0, 1]]
    pose = _array(name, value, (4, 4))
    if pose[3].tolist() != [0, 0, 0, 1]:
        raise ValueError(f"{name} has the last row {pose[3].tolist()}; expected 0 0 0 1 (matrices act on columns)")
    rotation = pose[:3, :3]
    error, determinant = np.max(np.abs(rotation.T @ rotation - np.eye(3))), np.linalg.det(rotation)
    if not error <= RIGID:
        raise ValueError(
            f"{name} holds no rotation: its columns are off orthonormal ones by {error:.2g} (allowed {RIGID:g}). "
            "Remove scale and shear"
        )
    if determinant < 0:
        raise ValueError(f"{name} mirrors: its determinant is -1, expected 1. Flip two axes instead of one")
    u, _, vt = np.linalg.svd(rotation)
    pose[:3, :3] = u @ vt
    pose = (invert_rigid(pose) if key == "camera_from_world" else pose) @ _AXES[convention]
    if np.max(np.abs(pose[:3, 3])) > MOST_DISTANCE:
        raise ValueError(
            f"{name} puts the camera at {np.round(pose[:3, 3], 3).tolist()}; expected metres, at most "
            f"{MOST_DISTANCE:g}. Convert millimetres to metres"
        )
    values = [*pose[:3, 3], *quaternion_from_rotation(pose[:3, :3])]
    return [round(float(value), _DIGITS) for value in values]


def _array(name: str, value: Any, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """Finite numbers of a certain shape."""
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.full((), np.nan)
    expected = " x ".join(map(str, shape)) + " numbers" if shape else "a number"
    if isinstance(value, str | bool) or array.shape != shape or not np.all(np.isfinite(array)):
        raise ValueError(f"{name} is not {expected}")
    return array.copy()
