"""The data of the paper's authors: pickled .npy files of YCB objects on a table.

    SRC/{train,test}/N.npy       a list of frames, or one view, each a dict of rgb (0 to 1), depth (m), mask_bin
                                 (background first), and optional obj_list, misc, pcd
    camera_info.npy              camera of all files, unless misc has camera_intrinsics and camera_extrinsics;
                                 in SRC, SRC/constants or the folder above, or named by --camera

Focal lengths are negative: the camera's x axis points left and its y axis up, as in CoppeliaSim.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from datagen.errors import CorruptFile, UsageError
from datagen.formats.import_request import ReadOptions
from datagen.formats.importers.interface import Facts, Found, Images, Recording
from datagen.formats.importers.restricted_pickle import read_pickled_npy
from datagen.rgbd.camera_pose import check_pose
from datagen.rgbd.files import HALF_PIXEL, check_intrinsics, check_unit
from datagen.schema import SPLITS

CAMERA = "camera_info.npy"
_MOST_OBJECTS = 64
_NEAR = 0.01
"""Largest median distance between the points of a file and those of its depth, metres; more means a wrong camera."""

Frame = dict[str, Any]


@dataclass(frozen=True, eq=False)
class _Camera:
    """Camera in our conventions."""

    k: Float64[np.ndarray, "3 3"]
    world_from_camera: Float64[np.ndarray, "4 4"]


def find_obpose(source: Path, options: ReadOptions) -> Found:
    """Find the authors' files; see `interface.Importer`."""
    if not source.is_dir():
        raise UsageError(f"{source} is no folder; expected one with train/ and test/ of .npy files.")
    places = [(split, source / split) for split in SPLITS if (source / split).is_dir()] or [(None, source)]
    files = [(split, path) for split, folder in places for path in _numbered(folder)]
    if not files:
        raise UsageError(f"{source} holds no files such as train/0.npy or 0.npy.")
    shared = _shared_camera(source, options)
    # Windows of a clip are read one after the other, and its file has to be parsed as a whole.
    load = functools.lru_cache(maxsize=1)(_load_frames)
    readers = [(split, _Reader(path, load, shared, options)) for split, path in files]
    recordings = [Recording(str(reader.path), split, reader.survey, reader.read) for split, reader in readers]
    return Found(recordings, "clip")


def _numbered(folder: Path) -> list[Path]:
    found = [path for path in folder.glob("*.npy") if path.stem.isdecimal()]
    return sorted(found, key=lambda path: int(path.stem))


def _shared_camera(source: Path, options: ReadOptions) -> _Camera | None:
    places = [source / CAMERA, source / "constants" / CAMERA, source.parent / CAMERA]
    path = options.camera or next((path for path in places if path.exists()), None)
    if path is None:
        return None
    try:
        values = read_pickled_npy(path)
    except FileNotFoundError:
        raise UsageError(f"--camera {path} does not exist.") from None
    return _camera(values, path)


def _camera(values: Any, path: Path) -> _Camera:
    """Convert camera_intrinsics and camera_extrinsics to our conventions."""
    try:
        k, pose = (np.asarray(values[name], np.float64) for name in ("camera_intrinsics", "camera_extrinsics"))
        if k.shape != (3, 3) or pose.shape != (4, 4) or not np.isfinite(k).all():
            raise ValueError
    except (ValueError, TypeError, LookupError, OverflowError):
        raise CorruptFile(
            f"{path} holds no camera; expected camera_intrinsics (3, 3) and camera_extrinsics (4, 4), both finite."
        ) from None
    signs = np.sign([k[0, 0], k[1, 1]])
    if signs[0] != signs[1] or not signs.all():
        raise UsageError(
            f"{path}: one focal length is negative and one is not, so that images are mirrored; flip them."
        )
    # Turning the camera by half a turn about its optical axis makes both focal lengths positive.
    turn = np.diag([signs[0], signs[1], 1, 1])
    check_pose(pose, f"{path}: camera_extrinsics")
    return _Camera(k @ turn[:3, :3] + HALF_PIXEL, pose @ turn)


class _Reader:
    """Images of one file."""

    def __init__(self, path: Path, load: Callable[[Path], list[Frame]], camera: _Camera | None, options: ReadOptions):
        self.path, self._load, self._shared, self._options = path, load, camera, options

    def survey(self) -> Facts:
        frames = self._load(self.path)
        height, width = frames[0]["depth"].shape
        check_intrinsics(self._camera(frames[0]).k, (width, height), str(self.path))
        most = max(frame["mask_bin"].shape[2] - 1 for frame in frames) if self._has_masks(frames) else None
        return Facts(len(frames), 1, (width, height), most, posed=True)

    def read(self, images: Sequence[int]) -> Images:
        every = self._load(self.path)
        frames, has_masks = [every[number] for number in images], self._has_masks(every)
        cameras = [self._camera(frame) for frame in frames]
        scale = self._options.depth_scale or 1.0
        with np.errstate(over="ignore"):  # becomes infinite, which is missing
            depth = np.stack([np.asarray(frame["depth"], np.float32)[None] * np.float32(scale) for frame in frames])
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
        check_unit(depth, scale, str(self.path))
        for frame, planar, camera in zip(frames, depth, cameras, strict=True):
            self._check_points(frame, planar[0], camera)
        return Images(
            rgb=np.stack([_colour(frame["rgb"], self.path)[None] for frame in frames]),
            depth=depth,
            k=np.stack([camera.k[None] for camera in cameras]),
            world_from_camera=np.stack([camera.world_from_camera[None] for camera in cameras]),
            ids=np.stack([_ids(frame["mask_bin"])[None] for frame in frames]) if has_masks else None,
            categories=_categories(frames) if has_masks else None,
        )

    def _has_masks(self, frames: list[Frame]) -> bool:
        return not self._options.ignore_masks and all("mask_bin" in frame for frame in frames)

    def _camera(self, frame: Frame) -> _Camera:
        misc = frame.get("misc")
        if type(misc) is dict and "camera_intrinsics" in misc:
            return _camera(misc, self.path)
        if self._shared is None:
            raise UsageError(f"{self.path} names no camera; name the file {CAMERA} with --camera.")
        return self._shared

    def _check_points(self, frame: Frame, depth: np.ndarray, camera: _Camera) -> None:
        """Compare the points that the file stores with those of its depth and camera."""
        stored = frame.get("pcd")
        if not isinstance(stored, np.ndarray) or stored.dtype.kind != "f" or stored.shape != (*depth.shape, 3):
            return
        if not (depth > 0).any():
            return
        rows, columns = np.nonzero(depth > 0)
        pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])
        points = (np.linalg.inv(camera.k) @ pixels) * depth[rows, columns]
        points = camera.world_from_camera[:3, :3] @ points + camera.world_from_camera[:3, 3:]
        with np.errstate(over="ignore", invalid="ignore"):
            away = float(np.median(np.linalg.norm(points.T - stored[rows, columns], axis=1)))
        if not away < _NEAR:
            raise UsageError(
                f"{self.path}: its points (pcd) are {away:.2g} m away from those of its depth and camera; expected "
                f"less than {_NEAR:g} m. Name the right {CAMERA} with --camera."
            )


def _load_frames(path: Path) -> list[Frame]:
    """Read and check all frames of a file."""
    try:
        values = read_pickled_npy(path)
    except FileNotFoundError:
        raise UsageError(f"{path} is missing.") from None
    frames = values if type(values) is list else [values]
    if not frames:
        raise CorruptFile(f"{path} holds no frames.")
    shape = _checked(frames[0], path)["depth"].shape
    if any(_checked(frame, path)["depth"].shape != shape for frame in frames):
        raise CorruptFile(f"{path} has frames of different sizes; expected one size.")
    return frames


def _checked(frame: Any, path: Path) -> Frame:
    expected = (("rgb", None), ("depth", None), ("mask_bin", np.zeros(0)))
    if type(frame) is not dict or not all(isinstance(frame.get(*each), np.ndarray) for each in expected):
        raise CorruptFile(f"{path} holds no frames; expected dicts with arrays rgb, depth and, optionally, mask_bin.")
    height, width = frame["depth"].shape if frame["depth"].ndim == 2 else (0, 0)
    mask = frame.get("mask_bin", np.zeros((height, width, 1)))
    fits = mask.ndim == 3 and mask.shape[:2] == (height, width)
    numeric = all(array.dtype.kind in "biuf" for array in (frame["rgb"], frame["depth"], mask))
    if not height or frame["rgb"].shape != (height, width, 3) or not fits or not numeric:
        raise CorruptFile(
            f"{path} has rgb of shape {frame['rgb'].shape}, depth {frame['depth'].shape} and mask_bin "
            f"{mask.shape}; expected (h, w, 3), (h, w) and (h, w, 1 + objects)."
        )
    if not 1 <= mask.shape[2] <= 1 + _MOST_OBJECTS:
        raise CorruptFile(f"{path} has masks of {mask.shape[2] - 1} objects; expected 0 to {_MOST_OBJECTS}.")
    return frame


def _colour(rgb: np.ndarray, path: Path) -> np.ndarray:
    """Convert colours from 0..1 to bytes."""
    if rgb.dtype == np.uint8:
        return rgb
    if not np.all((rgb >= -1e-3) & (rgb <= 1 + 1e-3)):
        raise CorruptFile(f"{path} has colours from {np.min(rgb):.3g} to {np.max(rgb):.3g}; expected 0 to 1.")
    return np.rint(255 * np.clip(rgb, 0, 1)).astype(np.uint8)


def _ids(mask: np.ndarray) -> Int64[np.ndarray, "height width"]:
    """Ids from one-hot masks whose first channel is the background."""
    return np.argmax(mask, axis=2).astype(np.int64)


def _categories(frames: list[Frame]) -> dict[int, str] | None:
    """Names of the objects in the order of their masks; None if there are none or they do not fit."""
    objects = frames[0].get("obj_list")
    names = [each.get("name") for each in objects if type(each) is dict] if type(objects) is list else []
    if len(names) != frames[0]["mask_bin"].shape[2] - 1 or not all(type(name) is str for name in names):
        return None
    return {row + 1: str(name) for row, name in enumerate(names)}
