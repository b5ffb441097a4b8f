"""Poses on disk: the group `poses` of a file of label maps, with one row per pose, as images may have few of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import h5py
import numpy as np
from jaxtyping import Float, Int64, Integer

from benchmark.models.contract import ARRAYS, pose_fault
from benchmark.models.interface import LARGEST_LABEL, Poses
from datagen.errors import UsageError
from datagen.storage.safe_io import hdf5_dataset, read_hdf5

GROUP = "poses"
INDEX = "index"
"""Scene, frame, view and label of each row."""


@dataclass
class PoseRows:
    """Collects the poses of a split."""

    index: list[Int64[np.ndarray, "pose 4"]] = field(default_factory=list)
    values: dict[str, list[np.ndarray]] = field(default_factory=dict)

    def put(self, scene: int, poses: Poses) -> None:
        """Add the poses of one scene, except those that are nan.

        Raises:
            UsageError: the scene has other arrays than earlier scenes.
        """
        given = {name for name in ARRAYS if getattr(poses, name) is not None}
        if self.index and given != set(self.values):
            before = ", ".join(sorted(self.values))
            raise UsageError(f"Scene {scene} has poses with {', '.join(sorted(given))}, those before with {before}.")
        there = np.argwhere(np.isfinite(poses.center).all(axis=-1))
        self.index.append(np.column_stack([np.full(len(there), scene), there]))
        for name in given:
            self.values.setdefault(name, []).append(getattr(poses, name)[tuple(there.T)])

    def write(self, file: h5py.File) -> None:
        """Write all poses; nothing if no scene has any."""
        if not self.index:
            return
        group = file.create_group(GROUP)
        group[INDEX] = np.concatenate(self.index)
        for name, arrays in self.values.items():
            group[name] = np.concatenate(arrays)


def poses_in(file: h5py.File, scenes: Sequence[int]) -> list[Poses] | None:
    """Read the poses of some scenes from an open file of label maps; None if it has none.

    Raises:
        ValueError: they are damaged, or break the contract (`benchmark.models.contract`).
    """
    if GROUP not in file:
        return None
    count, frames, views = hdf5_dataset(file, "labels", ndim=5).shape[:3]
    stored = hdf5_dataset(file, f"{GROUP}/{INDEX}", ndim=2, kinds="iu")
    # Check before reading: a few bytes can declare millions of rows.
    if len(stored) > (most := count * frames * views * (LARGEST_LABEL + 1)):
        raise ValueError(f"{GROUP}/{INDEX} has {len(stored)} rows; expected at most {most}, one for each label")
    index = read_hdf5(stored)
    _check_index(index, (count, frames, views, LARGEST_LABEL + 1))
    rows = {name: _values(file, name, len(index)) for name in ARRAYS if f"{GROUP}/{name}" in file}
    every = [_scene(index, rows, scene, (frames, views)) for scene in scenes]
    for scene, arrays in zip(scenes, every, strict=True):
        if fault := pose_fault(arrays, (frames, views)):
            raise ValueError(f"poses of scene {scene}: {fault}")
    return [Poses(**arrays) for arrays in every]


def _check_index(index: Integer[np.ndarray, "pose column"], sizes: tuple[int, int, int, int]) -> None:
    """Check that all rows are different, and that their scenes, frames, views and labels exist."""
    name = f"{GROUP}/{INDEX}"
    if index.shape[1] != 4:
        raise ValueError(f"{name} has shape {index.shape}; expected (poses, 4): scene, frame, view and label")
    wrong = np.argwhere((index < 0) | (index >= np.array(sizes)))
    if len(wrong):
        row, column = wrong[0].tolist()
        what = ("scene", "frame", "view", "label")[column]
        raise ValueError(f"{name} names {what} {index[row, column]} in row {row}; expected 0 to {sizes[column] - 1}")
    if len(np.unique(index, axis=0)) < len(index):
        raise ValueError(f"{name} names one label of an image twice; expected one pose each")


def _values(file: h5py.File, name: str, count: int) -> np.ndarray:
    dataset = hdf5_dataset(file, f"{GROUP}/{name}", kinds="f")
    if dataset.shape != (count, *ARRAYS[name]):
        raise ValueError(f"{GROUP}/{name} has shape {dataset.shape}; expected {(count, *ARRAYS[name])}, as {INDEX} has")
    return read_hdf5(dataset).astype(np.float64)


def _scene(
    index: Integer[np.ndarray, "pose 4"], rows: Mapping[str, np.ndarray], scene: int, images: tuple[int, int]
) -> dict[str, np.ndarray]:
    """Build the arrays of one scene, nan where it has no pose."""
    mine = index[:, 0] == scene
    place = index[mine, 1:].astype(np.int64)
    size = (*images, int(place[:, 2].max(initial=0)) + 1)
    return {name: _filled(values[mine], place, size) for name, values in rows.items()}


def _filled(
    values: Float[np.ndarray, "pose *shape"], place: Int64[np.ndarray, "pose 3"], size: tuple[int, int, int]
) -> Float[np.ndarray, "frame view label *shape"]:
    """Put values in their places; all other places are nan."""
    array = np.full((*size, *values.shape[1:]), np.nan)
    array[tuple(place.T)] = values
    return array
