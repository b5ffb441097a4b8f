"""Label maps on disk, and poses beside them: one HDF5 file a run, from which every score can be computed again."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import UInt8

from benchmark.files import replacing
from benchmark.interface import Prediction
from benchmark.label_files import reading_labels
from benchmark.pose_files import PoseRows

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
    """Label maps and background slot of every scene, in order.

    Raises:
        UsageError: there is no such file.
        CorruptFile: it is damaged.
    """
    with reading_labels(path) as file:
        labels, slots = file["labels"], file["background_slots"]
        assert isinstance(labels, h5py.Dataset)
        assert isinstance(slots, h5py.Dataset)
        for scene in range(len(labels)):
            yield labels[scene], int(slots[scene])


def dataset_of(path: Path) -> Path:
    """Folder of the dataset that the label maps are of, on the machine that made them.

    Raises:
        UsageError: there is no such file.
        CorruptFile: it is damaged.
    """
    with reading_labels(path) as file:
        return Path(str(file.attrs["data"]))
