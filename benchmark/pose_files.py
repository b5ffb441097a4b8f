"""Poses on disk, in a group `poses` of the file of the label maps: one row a pose, as there may be few in any image."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float, Int64

from benchmark.interface import Poses
from benchmark.label_files import reading_labels
from datagen.errors import UsageError

GROUP = "poses"
INDEX = "index"
"""Scene, frame, view and label of each row."""
_ARRAYS = ("center", "rotation", "size")


@dataclass
class PoseRows:
    """Collects the poses of a split."""

    index: list[Int64[np.ndarray, "pose 4"]] = field(default_factory=list)
    values: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def put(self, scene: int, poses: Poses) -> None:
        """Take the poses of one scene, without those that are nan.

        Raises:
            UsageError: it has other arrays than the scenes before.
        """
        given = {name for name in _ARRAYS if getattr(poses, name) is not None}
        if self.index and given != set(self.values):
            before = ", ".join(sorted(self.values))
            raise UsageError(f"Scene {scene} has poses with {', '.join(sorted(given))}, those before with {before}.")
        there = np.argwhere(np.isfinite(poses.center).all(axis=-1))
        self.index.append(np.column_stack([np.full(len(there), scene), there]))
        for name in given:
            self.values.setdefault(name, []).append(getattr(poses, name)[tuple(there.T)])

    def write(self, file: h5py.File) -> None:
        """Write them; without any scene that has poses, nothing."""
        if not self.index:
            return
        group = file.create_group(GROUP)
        group[INDEX] = np.concatenate(self.index)
        for name, arrays in self.values.items():
            group[name] = np.concatenate(arrays)


def read_poses(path: Path) -> list[Poses] | None:
    """Poses of every scene of a file of label maps, in order; None where its model gave none.

    Raises:
        UsageError: there is no such file.
        CorruptFile: it is damaged.
    """
    return _read(path, None)


def read_scene_poses(path: Path, scene: int) -> Poses | None:
    """The same of one scene."""
    found = _read(path, scene)
    return found[0] if found else None


def _read(path: Path, only: int | None) -> list[Poses] | None:
    with reading_labels(path) as file:
        if GROUP not in file:
            return None
        scenes, frames, views = file["labels"].shape[:3]  # pyright: ignore[reportAttributeAccessIssue]
        names = (INDEX, *(name for name in _ARRAYS if f"{GROUP}/{name}" in file))
        rows = {name: np.asarray(file[f"{GROUP}/{name}"]) for name in names}
        return [_scene(rows, scene, frames, views) for scene in (range(scenes) if only is None else (only,))]


def _scene(rows: Mapping[str, np.ndarray], scene: int, frames: int, views: int) -> Poses:
    mine = rows[INDEX][:, 0] == scene
    place = rows[INDEX][mine, 1:]
    labels = int(place[:, 2].max(initial=0)) + 1
    arrays = {name: _filled(rows[name][mine], place, (frames, views, labels)) for name in rows if name != INDEX}
    return Poses(**arrays)


def _filled(
    values: Float[np.ndarray, "pose *shape"], place: Int64[np.ndarray, "pose 3"], size: tuple[int, int, int]
) -> Float[np.ndarray, "frame view label *shape"]:
    """Values in their places; nan in all others."""
    array = np.full((*size, *values.shape[1:]), np.nan)
    array[tuple(place.T)] = values
    return array
