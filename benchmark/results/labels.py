"""Label maps on disk, and poses beside them: one HDF5 file per run, from which all scores can be recomputed."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import UInt8

from benchmark.models.interface import Poses, Prediction
from benchmark.models.pose_file import PoseWriter, poses_in
from benchmark.results.run_folder import LABELS, RunRow
from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.storage.atomic import replacing
from datagen.storage.reader import Split
from datagen.storage.safe_io import hdf5_attribute, hdf5_dataset, open_hdf5, read_hdf5
from datagen.tracks import find_dataset

_GZIP_LEVEL = 4
_ADVICE = "Delete its row in runs/ and run again."


class LabelWriter:
    """Writes the label maps of a split scene by scene."""

    def __init__(self, file: h5py.File, scenes: int):
        self._file, self._scenes = file, scenes
        self._slots = file.create_dataset("background_slots", (scenes,), np.uint8)
        self.poses = PoseWriter(file)

    def put(self, scene: int, prediction: Prediction) -> None:
        """Store one scene's labels, 0 to 255, and its background slot; poses are written in blocks."""
        labels = np.asarray(prediction.labels).astype(np.uint8)
        if "labels" not in self._file:
            shape, chunks = (self._scenes, *labels.shape), (1, *labels.shape)
            options = {"compression": "gzip", "compression_opts": _GZIP_LEVEL, "shuffle": False}
            self._file.create_dataset("labels", shape, np.uint8, chunks=chunks, **options)
        dataset = self._file["labels"]
        assert isinstance(dataset, h5py.Dataset)
        dataset[scene] = labels
        self._slots[scene] = prediction.background
        if prediction.poses is not None:
            self.poses.put(scene, prediction.poses)


@contextmanager
def write_labels(path: Path, scenes: int, data: Path) -> Iterator[LabelWriter]:
    """Write the label maps of that many scenes of the dataset `data`; the file appears only if no error occurs."""
    with replacing(path) as partial, h5py.File(partial, "w", libver=("v110", "v110")) as file:
        file.attrs["data"] = str(data.resolve())
        writer = LabelWriter(file, scenes)
        yield writer
        writer.poses.flush()


@contextmanager
def _reading(path: Path) -> Iterator[h5py.File]:
    """Open a run's file of label maps; raises UsageError if it does not exist, CorruptFile if it is damaged."""
    if not path.is_file():
        raise UsageError(
            f"There is no file {path}; expected label maps that a run of obpose-bench left in its folder. "
            "Published results are without them: the run's command makes them."
        )
    with open_hdf5(path, _ADVICE) as file:
        yield file


def read_labels(path: Path) -> Iterator[tuple[UInt8[np.ndarray, "frame view height width"], int]]:
    """Read label maps and background slot of every scene, in order.

    Raises:
        UsageError: the file does not exist.
        CorruptFile: it is damaged.
    """
    with _reading(path) as file:
        labels, slots = _labels_of(file), hdf5_dataset(file, "background_slots", ndim=1, kinds="u")
        if slots.shape != labels.shape[:1]:
            raise ValueError(f"background_slots has shape {slots.shape}; expected {labels.shape[:1]}, one a scene")
        for scene in range(len(labels)):
            yield read_hdf5(labels, scene), int(read_hdf5(slots, scene))


def read_poses(path: Path, scenes: Sequence[int] | None = None) -> list[Poses] | None:
    """Read the poses of some scenes, by default of all in order; None if the model gave none.

    Raises:
        UsageError: the file does not exist.
        CorruptFile: it is damaged.
    """
    with _reading(path) as file:
        if (stored := poses_in(file)) is None:
            return None
        return [stored[scene] for scene in (range(len(stored)) if scenes is None else scenes)]


def each_pose(path: Path) -> Iterator[Poses | None]:
    """Read the poses of every scene, in order; None for each if the model gave none. Raises as `read_poses`."""
    with _reading(path) as file:
        stored = poses_in(file)
        for scene in range(len(hdf5_dataset(file, "labels", ndim=5))):
            yield stored[scene] if stored else None


def check_labels_fit(path: Path, scenes: Split) -> None:
    """Check that a file has label maps of exactly these scenes, frames, views and pixels; reads only its header.

    Raises:
        UsageError: the file does not exist.
        CorruptFile: it is damaged, or has label maps of another shape.
    """
    with _reading(path) as file:
        found = _labels_of(file).shape
    if found != (expected := scenes.labels_shape):
        raise CorruptFile(
            f"{path} does not fit the dataset's scenes: it has label maps of shape {found}, expected {expected}. "
            "Run the model again."
        )


def _labels_of(file: h5py.File) -> h5py.Dataset:
    labels = hdf5_dataset(file, "labels", ndim=5, kinds="u")
    if labels.dtype.itemsize != 1:
        raise ValueError(f"labels has type {labels.dtype}; expected uint8")
    return labels


def dataset_of(path: Path) -> Path:
    """Read the folder of the dataset of some label maps, on the machine that made them.

    Raises:
        UsageError: the file does not exist.
        CorruptFile: it is damaged.
    """
    with _reading(path) as file:
        return Path(hdf5_attribute(file, "data", str))


def labels_path(folder: Path, row: RunRow) -> Path:
    """Path of a row's label maps, whether or not they were kept; seed 0 stands for all seeds of a model without any."""
    key = row.key if row.random else dataclasses.replace(row.key, seed=0)
    return folder / LABELS / f"{key.name}.h5"


def locate(folder: Path, row: RunRow, data: Iterable[Path] = ()) -> Path | None:
    """Find the dataset that a row was scored on; None if it is not on this machine.

    Searches the folders `data`, the folder named in the label maps, and the generated tracks.
    """
    candidates = list(data)
    with suppress(DatagenError):
        candidates.append(dataset_of(labels_path(folder, row)))
    return find_dataset(row.key.track, row.key.track_spec, candidates)
