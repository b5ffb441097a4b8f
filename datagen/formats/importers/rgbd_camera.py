"""camera.json of RGB-D recordings: intrinsics, unit of depth, poses, frame rate."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from datagen.errors import UsageError
from datagen.formats.import_request import ReadOptions
from datagen.formats.importers.files import HALF_PIXEL, camera_matrix, numbers, read_object

_MILLIMETRE = 0.001


@dataclass(frozen=True, eq=False)
class RgbdCamera:
    """Content of a camera.json."""

    k: Float64[np.ndarray, "image 3 3"]
    """One matrix for all images, or one for each."""
    depth_scale: float
    """Metres per unit of integer depth."""
    float_scale: float
    """Metres per unit of depth in floats."""
    euclidean: bool
    poses: Any
    """world_from_camera as JSON values: one matrix, or one for each image; None if missing."""
    fps: float | None

    def k_of(self, image: int) -> Float64[np.ndarray, "3 3"]:
        """Camera matrix of an image."""
        return self.k[image if len(self.k) > 1 else 0]


def read_camera(path: Path, options: ReadOptions) -> RgbdCamera:
    """Read a camera.json.

    Raises:
        UsageError: there is no such file, or a value is missing or impossible.
        CorruptFile: it is damaged.
    """
    values = read_object(path)
    bop = "cam_K" in values  # BOP gives depth_scale in millimetres per unit
    scale = values.get("depth_scale", values.get("depth_scale_m", 1.0 if bop else _MILLIMETRE))
    scale = options.depth_scale or _positive(scale, f"{path}: depth_scale") * (_MILLIMETRE if bop else 1)
    kind = options.depth_type or values.get("depth_type", "planar")
    if kind not in ("planar", "euclidean"):
        raise UsageError(f"{path}: depth_type is {kind!r:.40}; expected planar or euclidean.")
    fps = values.get("fps")
    return RgbdCamera(
        k=_intrinsics(values, path),
        depth_scale=scale,
        float_scale=options.depth_scale or 1.0,
        euclidean=kind == "euclidean",
        poses=values.get("world_from_camera"),
        fps=None if fps is None else _positive(fps, f"{path}: fps"),
    )


def _intrinsics(values: dict[str, Any], path: Path) -> Float64[np.ndarray, "image 3 3"]:
    """Read fx, fy, cx, cy or 3x3 matrices K; `pixel_center` says where the first pixel's centre is."""
    matrix = next((values[name] for name in ("K", "cam_K", "intrinsics") if name in values), None)
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
