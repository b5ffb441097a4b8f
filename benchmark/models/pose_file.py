"""Poses on disk: the group `poses` of a file of label maps, with one row per pose, as images may have few of them."""

import math
from collections.abc import Sequence
from typing import Any

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


_BLOCK = 1024
"""Rows that are collected before they are written."""


class PoseWriter:
    """Writes the poses of a split, block by block."""

    def __init__(self, file: h5py.File):
        self._file, self._names = file, set[str]()
        self._rows: dict[str, list[np.ndarray]] = {}
        self._collected = 0

    def put(self, scene: int, poses: Poses) -> None:
        """Add the poses of one scene, except those that are nan.

        Raises:
            UsageError: the scene has other arrays than earlier scenes.
        """
        given = {name for name in ARRAYS if getattr(poses, name) is not None}
        if self._names and given != self._names:
            before = ", ".join(sorted(self._names))
            raise UsageError(f"Scene {scene} has poses with {', '.join(sorted(given))}, those before with {before}.")
        self._names = given
        there = np.argwhere(np.isfinite(poses.center).all(axis=-1))
        self._rows.setdefault(INDEX, []).append(np.column_stack([np.full(len(there), scene), there]))
        for name in given:
            self._rows.setdefault(name, []).append(getattr(poses, name)[tuple(there.T)])
        self._collected += len(there)
        if self._collected >= _BLOCK:
            self.flush()

    def flush(self) -> None:
        """Write what was collected."""
        for name, blocks in self._rows.items():
            block = np.concatenate(blocks)
            if f"{GROUP}/{name}" not in self._file:
                shape = block.shape[1:]
                chunk = (_BLOCK // 2, *shape)
                self._file.create_dataset(
                    f"{GROUP}/{name}", (0, *shape), block.dtype, chunks=chunk, maxshape=(None, *shape)
                )
            stored = self._file[f"{GROUP}/{name}"]
            assert isinstance(stored, h5py.Dataset)
            stored.resize(len(stored) + len(block), axis=0)
            stored[len(stored) - len(block) :] = block
        self._rows, self._collected = {}, 0


Order = tuple[np.ndarray, np.ndarray]
"""Rows of the index sorted by scene, int32 [pose], and where each scene starts among them, int32 [scene + 1]."""


class StoredPoses(Sequence[Any]):
    """`Poses` of all scenes in an open file of label maps; those of a scene are read and checked when it is accessed.

    Raises:
        ValueError: they are damaged, or break the contract (`benchmark.models.contract`).
    """

    def __init__(self, file: h5py.File, order: Order | None = None):
        """Check the file; `order` is that of an earlier opening, in which its index was checked."""
        self._file = file
        self._count, *images = hdf5_dataset(file, "labels", ndim=5).shape[:3]
        self._images = images[0], images[1]
        stored = hdf5_dataset(file, f"{GROUP}/{INDEX}", ndim=2, kinds="iu")
        sizes = (self._count, *self._images, LARGEST_LABEL + 1)
        # Check before reading: a few bytes can declare millions of rows.
        if len(stored) > (most := math.prod(sizes)):
            raise ValueError(f"{GROUP}/{INDEX} has {len(stored)} rows; expected at most {most}, one for each label")
        self.order = order or _order(stored, sizes)
        self._datasets = {name: _values(file, name, len(stored)) for name in ARRAYS if f"{GROUP}/{name}" in file}
        self._index = stored

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, scene: Any) -> Any:
        order, starts = self.order
        rows = order[starts[scene] : starts[scene + 1]]
        place = _rows(self._index, rows)[:, 1:].astype(np.int64)
        size = (*self._images, int(place[:, 2].max(initial=0)) + 1)
        values = {name: _rows(dataset, rows).astype(np.float64) for name, dataset in self._datasets.items()}
        arrays = {name: _filled(array, place, size) for name, array in values.items()}
        if fault := pose_fault(arrays, self._images):
            raise ValueError(f"poses of scene {scene}: {fault}")
        return Poses(**arrays)


def poses_in(file: h5py.File) -> StoredPoses | None:
    """Open the poses of a file of label maps; None if it has none. Raises as `StoredPoses`."""
    return StoredPoses(file) if GROUP in file else None


def _order(stored: h5py.Dataset, sizes: tuple[int, int, int, int]) -> Order:
    """Check the index and sort its rows by scene; files of other projects may have them in any order."""
    index = read_hdf5(stored)
    _check_index(index, sizes)
    order = np.argsort(index[:, 0], kind="stable").astype(np.int32)
    return order, np.searchsorted(index[order, 0], np.arange(sizes[0] + 1)).astype(np.int32)


def _rows(dataset: h5py.Dataset, rows: Integer[np.ndarray, "row"]) -> np.ndarray:
    """Read some rows, which are neighbours in files of ours."""
    first, last = (int(rows.min()), int(rows.max())) if len(rows) else (0, -1)
    return read_hdf5(dataset, slice(first, last + 1))[rows - first]


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
    places = np.sort(np.ravel_multi_index(tuple(index.T.astype(np.int64)), sizes))
    if np.any(places[1:] == places[:-1]):
        raise ValueError(f"{name} names one label of an image twice; expected one pose each")


def _values(file: h5py.File, name: str, count: int) -> h5py.Dataset:
    dataset = hdf5_dataset(file, f"{GROUP}/{name}", kinds="f")
    if dataset.shape != (count, *ARRAYS[name]):
        raise ValueError(f"{GROUP}/{name} has shape {dataset.shape}; expected {(count, *ARRAYS[name])}, as {INDEX} has")
    return dataset


def _filled(
    values: Float[np.ndarray, "pose *shape"], place: Int64[np.ndarray, "pose 3"], size: tuple[int, int, int]
) -> Float[np.ndarray, "frame view label *shape"]:
    """Put values in their places; all other places are nan."""
    array = np.full((*size, *values.shape[1:]), np.nan)
    array[tuple(place.T)] = values
    return array
