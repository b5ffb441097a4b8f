"""Label maps made elsewhere, in one of three layouts; docs/benchmark.md shows them.

DIR/test/00017.npz ..................... `labels` [frame view height width], and `background_slot` if there is one
DIR/test/00017/view0_frame003.png ...... eight bits, grey or palette: a pixel's number is its label
DIR/labels.h5 .......................... `labels` [scene frame view height width], `background_slots` [scene]

The first and the last may hold poses: the arrays `center`, `rotation` and `size` of `benchmark.models.interface.Poses`
of a scene, or the group that `benchmark.models.pose_file` writes. Headers and small arrays are checked before any
scene is scored.
"""

import functools
import hashlib
import math
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import UInt8

from benchmark.models.contract import ARRAYS, pose_fault
from benchmark.models.interface import LARGEST_LABEL, Clip, Poses, Prediction
from benchmark.models.pose_file import GROUP, Order, StoredPoses, poses_in
from datagen.errors import UsageError
from datagen.storage.safe_io import file_version, hdf5_dataset, npz_headers, open_hdf5, open_image, read_hdf5, read_npz

SPLIT = "test"
HDF5 = "labels.h5"
LAYOUTS = f"{HDF5}, or {SPLIT}/00000.npz, or {SPLIT}/00000/view0_frame000.png, and so on for every scene"
ADVICE = "Write the file again."
AXES = "[scene frame view height width]"

_BIT_DEPTH = 24
"""Offset of the bits per pixel in a PNG file."""
_NPZ_NAMES = ("labels", "background_slot", *ARRAYS)

Shape = tuple[int, int, int, int, int]
"""Scenes, frames, views, height and width of a split."""


@dataclass(frozen=True)
class PredictionFolder:
    """A folder of label maps."""

    folder: Path
    background_slot: int | None = None
    """Background label of clips whose files do not name one."""

    def check(self, shape: Shape) -> None:
        """Check that the folder has label maps of exactly the scenes, frames and views of a split.

        Raises:
            UsageError: a file is missing, there is one too many, or an array does not fit the split's `shape`.
            CorruptFile: a file is damaged.
        """
        if self._is_hdf5():
            with open_hdf5(self.folder / HDF5, ADVICE) as file:
                _check_hdf5(self.folder / HDF5, file, shape)
            return
        scenes = range(shape[0])
        self._check_scenes(scenes)
        for scene in scenes:
            if self._npz(scene).exists():
                _check_npz(self._npz(scene), shape[1:])
            else:
                _check_images(self._images(scene), shape[1:])

    def digest(self) -> str:
        """SHA-256 of names and contents of the files that are scored, and of the background slot."""
        found = hashlib.sha256(str(self.background_slot).encode())
        for path in self._scored():
            found.update(f"{path.relative_to(self.folder).as_posix()}|".encode(errors="surrogateescape"))
            with path.open("rb") as file:
                found.update(hashlib.file_digest(file, "sha256").digest())
        return found.hexdigest()

    def read(self, scene: int, clip: Clip) -> Prediction:
        """Read the label maps of one scene, which must fit its clip.

        Raises:
            UsageError: they are missing, or do not fit.
            CorruptFile: a file is damaged.
        """
        size = clip.depth.shape
        if self._is_hdf5():
            path = self.folder / HDF5
            labels, slot, poses = _read_hdf5(path, scene, size)
        elif (path := self._npz(scene)).exists():
            labels, slot, poses = _read_npz(path, size)
        else:
            path = self._images(scene)
            labels, slot, poses = _read_images(path, size), None, None
        lowest, largest = int(labels.min()), int(labels.max())
        if lowest < 0 or largest > LARGEST_LABEL:
            raise UsageError(
                f"{path}: the labels of scene {scene} go from {lowest} to {largest}; expected 0 to {LARGEST_LABEL}. "
                "Renumber them."
            )
        return Prediction(labels, self.background_slot if slot is None else slot, poses=poses)

    def _scored(self) -> list[Path]:
        """Files with label maps, in order; notes and hidden files are left out."""
        if self._is_hdf5():
            return [self.folder / HDF5]
        root = self.folder / SPLIT
        found = sorted([*root.glob("*.npz"), *root.glob("*/*.png")])
        return [path for path in found if not any(part.startswith(".") for part in path.relative_to(root).parts)]

    def _is_hdf5(self) -> bool:
        if not (self.folder / HDF5).exists():
            return False
        if (self.folder / SPLIT).exists():
            raise UsageError(
                f"{self.folder} holds both {HDF5} and {SPLIT}/; expected one of the two. Remove the other."
            )
        return True

    def _npz(self, scene: int) -> Path:
        return self.folder / SPLIT / f"{scene:05d}.npz"

    def _images(self, scene: int) -> Path:
        return self.folder / SPLIT / f"{scene:05d}"

    def _check_scenes(self, scenes: range) -> None:
        """Check that every scene has a file or a folder of images, and that no other scenes are there."""
        for scene in scenes:
            npz, images = self._npz(scene).exists(), self._images(scene).is_dir()
            if not npz and not images:
                raise UsageError(f"{self.folder} has no label maps of scene {scene}: expected {LAYOUTS}.")
            if npz and images:
                raise UsageError(
                    f"{self._npz(scene)} and the folder of the same name are both there; expected one of the two. "
                    "Remove the other."
                )
        expected = {path.name for scene in scenes for path in (self._npz(scene), self._images(scene))}
        found = (path for path in (self.folder / SPLIT).iterdir() if path.is_dir() or _is_scene(path))
        _refuse_others(found, expected, f"the dataset has {len(scenes)} scenes in its split {SPLIT}, from 00000 on")


def _is_scene(path: Path) -> bool:
    return path.suffix.lower() == ".npz" or bool(re.fullmatch(r"\d+", path.stem))


def _refuse_others(found: Iterable[Path], expected: Collection[str], why: str) -> None:
    """Reject files that would not be scored, except hidden ones, such as those of macOS."""
    others = sorted(path for path in found if path.name not in expected and not path.name.startswith("."))
    if others:
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        raise UsageError(
            f"{others[0]}{more}: these label maps belong to nothing that is scored; {why}. Remove them, or name the "
            "dataset that they are of."
        )


def _check_hdf5(path: Path, file: h5py.File, shape: Shape) -> None:
    """Check everything except the labels of the pixels; raises ValueError if the file is damaged."""
    _refuse_misspelt(path, file, ("background_slot", *ARRAYS), f"background_slots, and {GROUP}/center and so on")
    _labels_of(path, file, shape)
    _background_slots(path, file, shape[0])
    if poses := poses_in(file):
        for scene in range(len(poses)):
            _ = poses[scene]  # checks them


def _labels_of(path: Path, file: h5py.File, shape: tuple[int, ...]) -> h5py.Dataset:
    if "labels" not in file:
        raise UsageError(f"{path} has no array `labels`; expected integers of shape {shape}, {AXES}.")
    labels = hdf5_dataset(file, "labels")
    _check_array(path, "labels", (labels.shape, labels.dtype), shape, AXES)
    return labels


def _background_slots(path: Path, file: h5py.File, scenes: int) -> np.ndarray | None:
    if "background_slots" not in file:
        return None
    dataset = hdf5_dataset(file, "background_slots")
    _check_array(path, "background_slots", (dataset.shape, dataset.dtype), (scenes,), "[scene]")
    slots = read_hdf5(dataset)
    _check_slots(path, "background_slots", slots)
    return slots


def _read_hdf5(path: Path, scene: int, size: tuple[int, ...]) -> tuple[np.ndarray, int | None, Poses | None]:
    with open_hdf5(path, ADVICE) as file:
        there = hdf5_dataset(file, "labels").shape if "labels" in file else ()
        labels = _labels_of(path, file, (max(scene + 1, *there[:1], 0), *size))
        slots = _background_slots(path, file, len(labels))
        order = _order(path, file_version(path))
        poses = StoredPoses(file, order) if order else None
        slot = None if slots is None else int(slots[scene])
        return read_hdf5(labels, scene), slot, None if poses is None else poses[scene]


@functools.lru_cache(maxsize=1)
def _order(path: Path, _version: tuple[int, ...] | None) -> Order | None:
    """Rows of the poses of each scene, found once for each version of a file."""
    with open_hdf5(path, ADVICE) as file:
        poses = poses_in(file)
        return poses.order if poses else None


def _check_npz(path: Path, size: tuple[int, ...]) -> None:
    """Check types and shapes of all arrays, and the values of all except the labels."""
    headers = npz_headers(path, (*_NPZ_NAMES, "background_slots"))
    _refuse_misspelt(path, headers, ("background_slots",), "background_slot, one number")
    if "labels" not in headers:
        raise UsageError(f"{path} has no array `labels`; expected integers of shape {size}, [frame view height width].")
    _check_array(path, "labels", headers["labels"], size, "[frame view height width]")
    small = [name for name in headers if name != "labels"]
    if "background_slot" in headers:
        _check_array(path, "background_slot", headers["background_slot"], (), "one number")
    _check_pose_sizes(path, headers, size[0] * size[1])
    arrays = read_npz(path, small) if small else {}
    if "background_slot" in arrays:
        _check_slots(path, "background_slot", arrays["background_slot"])
    if fault := pose_fault(arrays, (size[0], size[1])):
        raise UsageError(f"{path}: {fault}. Correct the poses, or leave them out.")


def _check_pose_sizes(path: Path, headers: Mapping[str, Any], images: int) -> None:
    """Check from headers that arrays of poses are small: a compressed file of a few bytes can declare millions."""
    for name in ARRAYS:
        most = images * (LARGEST_LABEL + 1) * math.prod(ARRAYS[name])
        if name in headers and math.prod(headers[name][0]) > most:
            raise UsageError(
                f"{path}: {name} of poses has shape {headers[name][0]}; expected at most {most} numbers, for "
                f"{LARGEST_LABEL + 1} labels of {images} images. Correct the poses, or leave them out."
            )


def _read_npz(path: Path, size: tuple[int, ...]) -> tuple[np.ndarray, int | None, Poses | None]:
    _check_npz(path, size)
    arrays = read_npz(path, _NPZ_NAMES)
    slot = int(arrays["background_slot"]) if "background_slot" in arrays else None
    poses = {name: arrays[name] for name in ARRAYS if name in arrays}
    return arrays["labels"], slot, Poses(**poses) if poses else None


def _check_images(folder: Path, size: tuple[int, ...]) -> None:
    """Check that every frame and view has an image of the right size and kind, and that there are no others."""
    frames, views, height, width = size
    names = {_image_name(frame, view) for frame in range(frames) for view in range(views)}
    for name in sorted(names):
        if not (folder / name).exists():
            raise UsageError(f"{folder / name} is missing: expected {LAYOUTS}.")
        with open_image(folder / name, ("PNG",)) as image:
            _check_image(folder / name, image.mode, (image.height, image.width), (height, width))
    found = (path for path in folder.iterdir() if path.suffix.lower() == ".png" or path.is_dir())
    _refuse_others(found, names, f"clips have frames 0 to {frames - 1} and views 0 to {views - 1}")


def _image_name(frame: int, view: int) -> str:
    return f"view{view}_frame{frame:03d}.png"


def _check_image(path: Path, mode: str, found: tuple[int, int], expected: tuple[int, int]) -> None:
    with path.open("rb") as file:
        bits = file.read(_BIT_DEPTH + 1)[_BIT_DEPTH]
    if mode not in ("L", "P") or (mode == "L" and bits != 8):
        raise UsageError(f"{path} has mode {mode}, {bits} bits; expected eight bits, grey or palette (L or P).")
    if found != expected:
        raise UsageError(f"{path} has {found[1]} x {found[0]} pixels; expected {expected[1]} x {expected[0]}.")


def _read_images(folder: Path, size: tuple[int, ...]) -> UInt8[np.ndarray, "frame view height width"]:
    _check_images(folder, size)
    images = [[_read_png(folder / _image_name(frame, view)) for view in range(size[1])] for frame in range(size[0])]
    return np.array(images)


def _read_png(path: Path) -> UInt8[np.ndarray, "height width"]:
    with open_image(path, ("PNG",)) as image:
        return np.asarray(image)


def _refuse_misspelt(path: Path, there: Collection[str], names: Iterable[str], expected: str) -> None:
    """Reject arrays that belong to another layout, and would be ignored in this one."""
    if wrong := [name for name in names if name in there]:
        raise UsageError(f"{path} holds an array `{wrong[0]}`, which this layout does not have; expected {expected}.")


def _check_array(
    path: Path, name: str, found: tuple[tuple[int, ...], np.dtype[Any]], shape: tuple[int, ...], axes: str
) -> None:
    """Check type and shape of an array of integers."""
    if found[1].kind not in "iu" or found[0] != shape:
        raise UsageError(
            f"{path}: `{name}` is {found[1]} of shape {found[0]}; expected integers of shape {shape}, {axes}. Write "
            "exactly what the dataset has, or name the dataset that the label maps are of."
        )


def _check_slots(path: Path, name: str, slots: np.ndarray) -> None:
    wrong = slots[(slots < 0) | (slots > LARGEST_LABEL)]
    if wrong.size:
        raise UsageError(f"{path}: `{name}` holds {wrong.flat[0]}; expected 0 to {LARGEST_LABEL}.")
