"""Label maps that were made elsewhere, in one of three layouts; docs/adding_a_model.md shows them.

DIR/test/00017.npz ..................... `labels` [frame view height width], and `background_slot` if there is one
DIR/test/00017/view0_frame003.png ...... eight bits, grey or palette: a pixel's number is its label
DIR/labels.h5 .......................... `labels` [scene frame view height width], `background_slots` [scene]

The first and the last may hold poses: arrays `center`, `rotation` and `size` of `benchmark.interface.Poses` beside the
labels of a scene, or what `benchmark.pose_files` writes.
"""

import hashlib
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Integer
from PIL import Image, UnidentifiedImageError

from benchmark.interface import Clip, Poses, Prediction
from benchmark.pose_files import read_scene_poses
from datagen.errors import CorruptFile, UsageError

SPLIT = "test"
HDF5 = "labels.h5"
EXPECTED = f"expected {HDF5}, or {SPLIT}/00000.npz, or {SPLIT}/00000/view0_frame000.png, and so on for every scene"


@dataclass(frozen=True)
class PredictionFolder:
    """A folder of label maps."""

    folder: Path
    background_slot: int | None = None
    """Of clips whose files do not say."""

    def check(self, scenes: int) -> None:
        """Check that every scene has a file.

        Raises:
            UsageError: says which is the first without.
        """
        if (self.folder / HDF5).exists():
            return
        for scene in range(scenes):
            if not self._npz(scene).exists() and not self._images(scene).is_dir():
                raise UsageError(f"{self.folder} has no label maps of scene {scene}: {EXPECTED}.")

    def digest(self) -> str:
        """SHA-256 of names and contents of all files, and of the background slot."""
        found = hashlib.sha256(str(self.background_slot).encode())
        root = self.folder / HDF5 if (self.folder / HDF5).exists() else self.folder / SPLIT
        for path in sorted(root.rglob("*")) if root.is_dir() else [root]:
            if path.is_file():
                found.update(f"{path.relative_to(self.folder).as_posix()}|".encode())
                found.update(hashlib.sha256(path.read_bytes()).digest())
        return found.hexdigest()

    def read(self, scene: int, clip: Clip) -> Prediction:
        """The label maps of one scene.

        Raises:
            UsageError: they are not there, or not of the layout.
            CorruptFile: a file is damaged.
        """
        poses = None
        if (path := self.folder / HDF5).exists():
            (labels, slot), poses = _read_hdf5(path, scene), read_scene_poses(path, scene)
        elif (path := self._npz(scene)).exists():
            labels, slot, poses = _read_npz(path)
        else:
            frames, views = clip.depth.shape[:2]
            images = [[_read_png(self._images(scene), view, frame) for view in range(views)] for frame in range(frames)]
            labels, slot = _stack(images, self._images(scene)), None
        return Prediction(labels, self.background_slot if slot is None else slot, poses=poses)

    def _npz(self, scene: int) -> Path:
        return self.folder / SPLIT / f"{scene:05d}.npz"

    def _images(self, scene: int) -> Path:
        return self.folder / SPLIT / f"{scene:05d}"


def _read_hdf5(path: Path, scene: int) -> tuple[np.ndarray, int | None]:
    try:
        with h5py.File(path, "r", locking=False) as file:
            if not isinstance(labels := file.get("labels"), h5py.Dataset) or not scene < len(labels):
                raise UsageError(f"{path} has no `labels` of scene {scene}; expected [scene frame view height width].")
            slots = file.get("background_slots")
            return labels[scene], int(slots[scene]) if isinstance(slots, h5py.Dataset) else None
    except OSError as error:
        raise CorruptFile(f"{path} is damaged or no HDF5 file ({error}).") from None


def _read_npz(path: Path) -> tuple[np.ndarray, int | None, Poses | None]:
    try:
        with np.load(path, allow_pickle=False) as file:
            if "labels" not in file:
                raise UsageError(f"{path} has no array `labels`; expected [frame view height width].")
            slot = int(file["background_slot"]) if "background_slot" in file else None
            arrays = {name: file[name] for name in ("center", "rotation", "size") if name in file}
            return file["labels"], slot, Poses(**arrays) if "center" in arrays else None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        # NumPy takes what it cannot read for a pickle and advises to load it: the last thing to do with a broken file.
        raise CorruptFile(f"{path} is damaged or no NPZ file; write it anew, with `numpy.savez`.") from None


def _read_png(folder: Path, view: int, frame: int) -> Integer[np.ndarray, "height width"]:
    path = folder / f"view{view}_frame{frame:03d}.png"
    try:
        with Image.open(path) as image:
            if image.mode not in ("L", "P"):
                raise UsageError(f"{path} has mode {image.mode}; expected eight bits, grey or palette (L or P).")
            return np.asarray(image)
    except FileNotFoundError:
        raise UsageError(f"{path} is missing: {EXPECTED}.") from None
    except (UnidentifiedImageError, OSError) as error:
        raise CorruptFile(f"{path} is damaged or no image ({error}).") from None


def _stack(images: list[list[np.ndarray]], folder: Path) -> np.ndarray:
    sizes = {image.shape for row in images for image in row}
    if len(sizes) > 1:
        raise UsageError(f"The images in {folder} have different sizes ({sorted(sizes)}); expected one.")
    return np.array(images)
