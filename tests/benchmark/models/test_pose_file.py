from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmark.models.interface import Poses, Prediction
from benchmark.results.labels import read_poses, write_labels
from datagen.errors import CorruptFile, UsageError


def test_poses_are_kept_as_they_were(tmp_path: Path):
    rng = np.random.default_rng(0)
    center = rng.normal(size=(2, 1, 4, 3))
    center[0, 0, 2] = np.nan
    labels = np.zeros((2, 1, 3, 3), np.int64)
    with write_labels(tmp_path / "maps.h5", 3, tmp_path) as writer:
        for scene, poses in enumerate([Poses(center), None, Poses(np.full((2, 1, 4, 3), np.nan))]):
            writer.put(scene, Prediction(labels, 0, poses=poses))
    first, *others = read_poses(tmp_path / "maps.h5") or []
    np.testing.assert_array_equal(first.center, center)
    assert (first.rotation, first.size) == (None, None)
    assert [np.isfinite(other.center).any() for other in others] == [False, False]


def test_poses_that_are_written_in_several_blocks_are_all_kept(tmp_path: Path):
    centers = np.random.default_rng(0).normal(size=(3, 5, 1, 256, 3))
    with write_labels(tmp_path / "maps.h5", len(centers), tmp_path) as writer:
        for scene, center in enumerate(centers):
            writer.put(scene, Prediction(np.zeros((5, 1, 3, 3), np.int64), 0, poses=Poses(center)))
    found = read_poses(tmp_path / "maps.h5") or []
    np.testing.assert_array_equal([poses.center for poses in found], centers)


def test_all_scenes_have_the_same_arrays(tmp_path: Path):
    labels, center = np.zeros((1, 1, 3, 3), np.int64), np.zeros((1, 1, 2, 3))
    with write_labels(tmp_path / "m.h5", 2, tmp_path) as writer:
        writer.put(0, Prediction(labels, 0, poses=Poses(center)))
        with pytest.raises(UsageError, match="Scene 1 has poses with center, size"):
            writer.put(1, Prediction(labels, 0, poses=Poses(center, size=center)))


def test_damaged_poses_are_named(tmp_path: Path):
    with write_labels(tmp_path / "maps.h5", 1, tmp_path) as writer:
        writer.put(0, Prediction(np.zeros((1, 1, 3, 3), np.int64), 0, poses=Poses(np.zeros((1, 1, 2, 3)))))
    with h5py.File(tmp_path / "maps.h5", "a") as file:
        del file["poses/index"]
    with pytest.raises(CorruptFile, match="poses/index is missing"):
        read_poses(tmp_path / "maps.h5")
