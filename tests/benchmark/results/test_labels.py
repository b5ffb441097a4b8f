"""A run's file of label maps may come from anybody: `report` and `rescore` read it."""

import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmark.models.interface import Prediction
from benchmark.results.labels import check_labels_fit, dataset_of, read_labels, write_labels
from datagen.errors import CorruptFile, UsageError
from datagen.storage.reader import Dataset, Split
from tests.worlds.traced import write_dataset


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Split:
    return Dataset(write_dataset(tmp_path_factory.mktemp("labels") / "data", scenes=2, frames=2, views=2)).split("test")


@pytest.fixture
def path(scenes: Split, tmp_path: Path) -> Path:
    with write_labels(tmp_path / "maps.h5", len(scenes), tmp_path) as writer:
        for index in range(len(scenes)):
            writer.put(index, Prediction(np.full(scenes.labels_shape[1:], index), index))
    return tmp_path / "maps.h5"


def replace(name: str, values: object) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> None:
        del file[name]
        if values is not None:
            file[name] = values

    return change


def refer(kind: type, *where: str) -> Callable[[h5py.File], object]:
    def change(file: h5py.File) -> None:
        del file["labels"]
        file["labels"] = kind(*where)

    return change


SHAPE = (2, 2, 2, 48, 64)


def test_what_was_written_is_read(path: Path, scenes: Split, tmp_path: Path):
    check_labels_fit(path, scenes)
    assert dataset_of(path) == tmp_path
    assert [(labels.shape, int(labels.max()), slot) for labels, slot in read_labels(path)] == [
        (SHAPE[1:], 0, 0),
        (SHAPE[1:], 1, 1),
    ]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (replace("labels", None), "labels is missing"),
        (replace("labels", np.zeros(SHAPE[1:], np.uint8)), "labels has shape (2, 2, 48, 64); expected 5 axes"),
        (replace("labels", np.zeros(SHAPE)), "labels has type float64"),
        (replace("labels", np.zeros(SHAPE, np.uint16)), "labels has type uint16; expected uint8"),
        (replace("labels", 3), "labels has type int64"),
        (refer(h5py.ExternalLink, "other.h5", "labels"), "is a link to another place"),
        (refer(h5py.SoftLink, "/background_slots"), "is a link to another place"),
        (refer(h5py.SoftLink, "/labels"), "is a link to another place"),
        (replace("background_slots", None), "background_slots is missing"),
        (replace("background_slots", np.zeros(1, np.uint8)), "background_slots has shape (1,); expected (2,)"),
        (replace("background_slots", np.zeros(2)), "background_slots has type float64"),
        (replace("background_slots", np.zeros(2, int)), "background_slots has type int64"),
        (lambda file: (file.pop("background_slots"), file.create_group("background_slots")), "is a group"),
    ],
)
def test_damage_is_named(path: Path, change: Callable[[h5py.File], object], reason: str):
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(CorruptFile, match=re.escape(reason)) as error:
        list(read_labels(path))
    assert "maps.h5" in str(error.value)
    assert "Delete its row in runs/ and run again." in str(error.value)


@pytest.mark.parametrize("value", [3, [1, 2], np.array(["a", "b"], dtype=object), b"\xff", 0.5])
def test_a_place_that_is_no_text_is_damage(path: Path, value: object):
    with h5py.File(path, "a") as file:
        file.attrs["data"] = value
    with pytest.raises(CorruptFile, match=r"maps\.h5"):
        dataset_of(path)


@pytest.mark.parametrize("shape", [(1, 2, 2, 48, 64), (3, 2, 2, 48, 64), (2, 2, 2, 48, 32), (10**9, 2, 2, 48, 64)])
def test_label_maps_of_other_scenes_are_refused_by_their_header(path: Path, scenes: Split, shape: tuple[int, ...]):
    """However many there seem to be: nothing of the size is read or reserved."""
    with h5py.File(path, "a") as file:
        del file["labels"]
        file.create_dataset("labels", shape, np.uint8, chunks=(1, 1, 1, 48, 32))
    with pytest.raises(CorruptFile, match=re.escape(f"shape {shape}, expected {SHAPE}")):
        check_labels_fit(path, scenes)


def test_a_file_that_is_none_is_named(tmp_path: Path):
    with pytest.raises(UsageError, match="There is no file"):
        list(read_labels(tmp_path / "maps.h5"))
    (tmp_path / "maps.h5").write_bytes(b"nonsense")
    with pytest.raises(CorruptFile, match=r"maps\.h5 is truncated, damaged or not an HDF5 file"):
        list(read_labels(tmp_path / "maps.h5"))
