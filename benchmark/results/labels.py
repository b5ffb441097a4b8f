"""Label maps on disk, and poses beside them: one HDF5 file a run, from which every score can be computed again."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import UInt8

from benchmark.models.interface import Prediction
from benchmark.results.label_files import reading_labels
from benchmark.results.pose_files import PoseRows
from datagen.errors import CorruptFile
from datagen.storage.atomic import replacing
from datagen.storage.reader import Split
from datagen.storage.safe_io import hdf5_attribute, hdf5_dataset, read_hdf5

LARGEST = 255
"""Labels are bytes."""
_GZIP_LEVEL = 4


class LabelWriter:
    """Takes the label maps of a split scene by scene."""

    def __init__(self, file: h5py.File, scenes: int):
        self._file, self._scenes = file, scenes
        self._slots = file.create_dataset("background_slots", (scenes,), np.uint8)
        self.poses = PoseRows()

    def put(self, scene: int, prediction: Prediction) -> None:
        """Store one scene's labels, 0 to 255, and its background slot; poses are written when all are there."""
        labels = np.asarray(prediction.labels).astype(np.uint8)
        if "labels" not in self._file:
            shape, chunks = (self._scenes, *labels.shape), (1, *labels.shape)
            options = {"compression": "gzip", "compression_opts": _GZIP_LEVEL, "shuffle": False}
            self._file.create_dataset("labels", shape, np.uint8, chunks=chunks, **options)
        self._dataset("labels")[scene] = labels
        self._slots[scene] = prediction.background
        if prediction.poses is not None:
            self.poses.put(scene, prediction.poses)

    def _dataset(self, name: str) -> h5py.Dataset:
        dataset = self._file[name]
        assert isinstance(dataset, h5py.Dataset)
        return dataset


@contextmanager
def write_labels(path: Path, scenes: int, data: Path) -> Iterator[LabelWriter]:
    """Write the label maps of that many scenes of the dataset `data`; the file is there only if all went well."""
    with replacing(path) as partial, h5py.File(partial, "w", libver=("v110", "v110")) as file:
        file.attrs["data"] = str(data.resolve())
        writer = LabelWriter(file, scenes)
        yield writer
        writer.poses.write(file)


def read_labels(path: Path) -> Iterator[tuple[UInt8[np.ndarray, "frame view height width"], int]]:
    """Read label maps and background slot of every scene, in order.

    Raises:
        UsageError: there is no such file.
        CorruptFile: it is damaged.
    """
    with reading_labels(path) as file:
        labels, slots = _labels_of(file), hdf5_dataset(file, "background_slots", ndim=1, kinds="u")
        if slots.shape != labels.shape[:1]:
            raise ValueError(f"background_slots has shape {slots.shape}; expected {labels.shape[:1]}, one a scene")
        for scene in range(len(labels)):
            yield read_hdf5(labels, scene), int(read_hdf5(slots, scene))


def check_labels_fit(path: Path, scenes: Split) -> None:
    """Check that a file has label maps of exactly these scenes, frames, views and pixels; reads its header alone.

    Raises:
        UsageError: there is no such file.
        CorruptFile: it is damaged, or has label maps of another shape.
    """
    with reading_labels(path) as file:
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
    """Read the folder of the dataset that the label maps are of, on the machine that made them.

    Raises:
        UsageError: there is no such file.
        CorruptFile: it is damaged.
    """
    with reading_labels(path) as file:
        return Path(hdf5_attribute(file, "data", str))
