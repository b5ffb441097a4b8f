"""The camera of a recording: `camera.json`, or arrays beside the frames in an NPZ file."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32, Float64

from datagen.errors import CorruptFile, UsageError
from datagen.rgbd.camera_pose import Pose, check_pose, pose_matrix
from datagen.rgbd.files import HALF_PIXEL, camera_matrix, numbers, planar_depth, read_object
from datagen.rgbd.images import holds_floats, read_depth
from datagen.storage.safe_io import read_npz

CAMERA = "camera.json"
MATRIX = ("K", "cam_K", "intrinsics")
_ARRAYS = (*MATRIX, "depth_scale", "depth_scale_m", "depth_type", "world_from_camera", "pixel_center", "fps")
"""Arrays of an NPZ file about the camera."""
MILLIMETRE = 0.001


@dataclass(frozen=True, eq=False)
class Camera:
    """Camera matrix, and how depth is stored."""

    lenses: Float64[np.ndarray, "image 3 3"]
    """Camera matrices, one for all images or one for each; pixels, pixel centres at +0.5."""
    depth_scale: float = MILLIMETRE
    """Metres per unit of integer depth."""
    float_scale: float = 1.0
    """Metres per unit of depth in floats."""
    euclidean: bool = False
    """Whether depth is the distance from the camera's centre, not along its axis."""
    poses: Any = None
    """world_from_camera as JSON values: one matrix, or one for each image; None if missing."""
    fps: float | None = None
    masks: str = ""
    """First word of `mask` in camera.json, in lower case: "predicted" by another model, "foreground" without separate
    objects, or anything else for true masks of objects."""
    file: Path | None = None

    def k(self, number: int = 0) -> Float64[np.ndarray, "3 3"]:
        """Camera matrix of an image."""
        return self.lenses[number if len(self.lenses) > 1 else 0]

    def depth(self, path: Path, number: int = 0) -> Float32[np.ndarray, "height width"]:
        """Read planar depth of an image in metres, 0 = missing; raises as `datagen.rgbd.images.read_depth`."""
        metres = read_depth(path, self.depth_scale)
        if self.float_scale != 1 and holds_floats(path):
            metres = metres * np.float32(self.float_scale)
        return planar_depth(metres, self.k(number)) if self.euclidean else metres

    def pose(self, number: int, images: int) -> Pose | None:
        """Find world_from_camera of one of `images` images; None if it is not in the camera's file.

        Raises:
            UsageError, CorruptFile: it is no rigid pose, or missing for this image; or there are more than images.
        """
        if self.poses is None:
            return None
        try:
            single = np.ndim(self.poses) == 2
            listed = self.poses if single else self.poses[number]
            surplus = not single and len(self.poses) > images
        except (ValueError, TypeError, LookupError):
            raise CorruptFile(
                f"{self.file}: world_from_camera holds no pose for image {number}; expected one 4x4 matrix, or one for "
                "each image."
            ) from None
        if surplus:
            raise UsageError(
                f"{self.file}: world_from_camera holds {len(self.poses)} poses for {images} images; expected one 4x4 "
                "matrix, or one for each image."
            )
        pose = pose_matrix(listed)
        check_pose(pose, f"{self.file}: world_from_camera")
        return pose


def read_camera(
    path: Path,
    *,
    depth_scale: float | None = None,
    depth_type: Literal["planar", "euclidean"] | None = None,
    k: Float64[np.ndarray, "3 3"] | None = None,
    default_scale: float = MILLIMETRE,
) -> Camera:
    """Read a camera from JSON or NPZ; values that are given replace those of the file.

    Raises:
        UsageError: values are missing or wrong.
        CorruptFile: the file is damaged.
    """
    values = _arrays(path) if path.suffix.lower() == ".npz" else read_object(path)
    bop = "cam_K" in values  # BOP gives depth_scale in millimetres per unit
    scale = values.get("depth_scale", values.get("depth_scale_m", 1.0 if bop else default_scale))
    kind = depth_type or values.get("depth_type", "planar")
    if kind not in ("planar", "euclidean"):
        raise UsageError(f"{path}: depth_type is {kind!r:.40}; expected planar or euclidean.")
    fps = values.get("fps")
    return Camera(
        lenses=_intrinsics(values, path) if k is None else k[None],
        depth_scale=depth_scale or _positive(scale, f"{path}: depth_scale") * (MILLIMETRE if bop else 1),
        float_scale=depth_scale or 1.0,
        euclidean=kind == "euclidean",
        poses=values.get("world_from_camera"),
        fps=None if fps is None else _positive(fps, f"{path}: fps"),
        masks=(re.findall("[a-z]+", str(values.get("mask", "")).lower()) or [""])[0],
        file=path,
    )


def _arrays(path: Path) -> dict[str, Any]:
    return {name: values.tolist() for name, values in read_npz(path, _ARRAYS).items()}


def _intrinsics(values: dict[str, Any], path: Path) -> Float64[np.ndarray, "image 3 3"]:
    """Read fx, fy, cx, cy or 3x3 matrices K; `pixel_center` says where the first pixel's centre is."""
    matrix = next((values[name] for name in MATRIX if name in values), None)
    if matrix is not None:
        several = np.ndim(np.asarray(matrix, object)) == 3
        k = np.stack([numbers(one, 9, f"{path}: K").reshape(3, 3) for one in (matrix if several else [matrix])])
    elif missing := [name for name in ("fx", "fy", "cx", "cy") if name not in values]:
        raise UsageError(f"{path} has no {missing[0]}; expected fx, fy, cx and cy in pixels, or a 3x3 matrix K.")
    else:
        lens = numbers([values[name] for name in ("fx", "fy", "cx", "cy")], 4, f"{path}: fx, fy, cx, cy")
        k = camera_matrix(*lens)[None]
    center = values.get("pixel_center", 0)
    if center not in (0, 0.5):
        raise UsageError(f"{path}: pixel_center is {center!r:.20}; expected 0 (OpenCV) or 0.5.")
    return k + HALF_PIXEL * (1 if center == 0 else 0)


def _positive(value: Any, place: str) -> float:
    if type(value) not in (int, float) or not 0 < value < 1e6:
        raise UsageError(f"{place} is {value!r:.40}; expected a number above 0.")
    return float(value)
