"""Poses on their way from a model to the scene table."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from benchmark.clips import ClipSequence
from benchmark.execution.scoring import BadPrediction, check_prediction, score_labels, segment_split
from benchmark.metrics.poses import POSE_METRICS
from benchmark.models.classical.boxes import OracleVisibleBoxes, OracleVisibleMeans
from benchmark.models.interface import Clip, Poses, Prediction
from benchmark.results.labels import write_labels
from benchmark.results.pose_files import read_poses
from benchmark.tasks.true_poses import read_true_poses
from datagen.errors import CorruptFile, UsageError
from datagen.storage.reader import Dataset, Split
from tests.worlds import rendered
from tests.worlds.sphere_clips import arbitrary


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = rendered.record(rendered.scene(views=2), resolution=(48, 48))
    return rendered.write_dataset(tmp_path_factory.mktemp("scoring") / "data", [scene, scene])


@pytest.fixture(scope="module")
def scenes(data: Path) -> Split:
    return Dataset(data).split("train")


def true_prediction(scenes: Split, clip: Clip) -> Prediction:
    assert clip.truth is not None
    true = read_true_poses(scenes, 0, clip, clip.truth)
    frames, views = clip.depth.shape[:2]
    rotation = np.einsum("foij,ojk->foik", true.rotation, true.box_rotation)
    size = np.broadcast_to(true.box_size, (frames, *true.box_size.shape))
    arrays = [np.repeat(values[:, None], views, axis=1) for values in (true.box_center, rotation, size)]
    rows = [np.concatenate([np.full_like(array[:, :, :1], np.nan), array], axis=2) for array in arrays]
    return Prediction(clip.truth.astype(np.int64), 0, poses=Poses(*rows))


def columns(folder: Path) -> dict[str, float]:
    (path,) = (folder / "scenes").iterdir()
    header, line, *_ = path.read_text().splitlines()
    return {name: float(value) for name, value in zip(header.split(","), line.split(","), strict=True)}


def score(predict, scenes: Split, data: Path, out: Path) -> dict[str, float]:
    clips = ClipSequence(scenes, uses_labels=True)
    segment_split(lambda _, clip: predict(clip), clips, out / "labels.h5", data)
    score_labels(out / "labels.h5", scenes, out, "name")
    return columns(out)


def test_true_poses_come_back_without_error(scenes: Split, data: Path, tmp_path: Path):
    found = score(lambda clip: true_prediction(scenes, clip), scenes, data, tmp_path)
    assert found["posed"] == 1
    assert found["box_iou"] == pytest.approx(1, abs=1e-4)
    assert found["translation_error"] < 1e-6
    assert found["orientation_error"] < 1e-2
    assert (found["posed_n"], found["translation_median_n"]) == (6, 1)
    assert found["translation_error_visible"] > 0.005


def test_what_is_visible_leans_towards_the_camera(scenes: Split, data: Path, tmp_path: Path):
    means = score(OracleVisibleMeans().segment, scenes, data, tmp_path / "means")
    assert means["translation_error_visible"] == pytest.approx(0, abs=1e-6)
    assert 0.01 < means["translation_error"] < 0.06
    boxes = score(OracleVisibleBoxes().segment, scenes, data, tmp_path / "boxes")
    assert boxes["posed"] == 1
    assert boxes["translation_error"] < means["translation_error"]
    assert 0.2 < boxes["box_iou"] < 0.95


def test_without_poses_there_are_no_such_columns(scenes: Split, data: Path, tmp_path: Path):
    found = score(lambda clip: Prediction(clip.truth.astype(np.int64), 0), scenes, data, tmp_path)
    assert not set(POSE_METRICS) & set(found)
    assert read_poses(tmp_path / "labels.h5") is None


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
    with pytest.raises(CorruptFile, match="damaged"):
        read_poses(tmp_path / "maps.h5")


CLIP = arbitrary(0)
GOOD = np.zeros((2, 2, 3, 3))
TURNED = np.broadcast_to(np.eye(3), (2, 2, 3, 3, 3))


def unchecked(**arrays: np.ndarray) -> Poses:
    """Arrays that do not fit each other: outside of tests nothing looks at their axes."""
    poses = Poses(GOOD)
    for name, array in arrays.items():
        object.__setattr__(poses, name, array)
    return poses


def changed(array: np.ndarray, value: float) -> np.ndarray:
    """One number replaced by another."""
    other = np.array(array)
    other[1, 0, 2].flat[1] = value
    return other


@pytest.mark.parametrize(
    ("poses", "message"),
    [
        (Poses(GOOD[:1]), r"center of poses float64 \(1, 2, 3, 3\)"),
        (unchecked(rotation=TURNED[:, :, :2]), "rotation of poses"),
        (Poses(GOOD, TURNED, GOOD - 1), "size is negative"),
        (Poses(GOOD, size=GOOD), "without rotation"),
        (Poses(GOOD, 2 * TURNED), "not a rotation matrix"),
        (Poses(GOOD, -TURNED), "not a rotation matrix"),
        (Poses(GOOD, np.full_like(TURNED, np.nan)), "only one of center and rotation is given"),
        (Poses(np.full_like(GOOD, np.nan), TURNED), "only one of center and rotation is given"),
        (Poses(changed(GOOD, np.inf)), "of frame 1, view 0, label 2 the center is infinite"),
        (Poses(changed(GOOD, -np.inf)), "center is infinite"),
        (Poses(changed(GOOD, np.nan)), "center is partly nan"),
        (Poses(GOOD, changed(TURNED, np.nan)), "rotation is partly nan"),
        (Poses(GOOD, TURNED, changed(GOOD, np.inf)), "size is infinite"),
        (Poses(GOOD, TURNED, changed(GOOD, np.nan)), "size is partly nan"),
        (Poses(changed(GOOD, 2e6)), "center is beyond 1,000,000 m"),
        (Poses(np.zeros((2, 2, 257, 3))), "poses of 257 labels; expected at most 256"),
        (unchecked(center=GOOD.astype(int)), "center of poses int64"),
        (unchecked(center=GOOD[0]), r"center of poses float64 \(2, 3, 3\); expected floats of \(2, 2, label, 3\)"),
    ],
)
def test_poses_that_are_none_are_refused(poses: Poses, message: str):
    labels = np.zeros(CLIP.depth.shape, np.int64)
    check_prediction(Prediction(labels, 0, poses=Poses(GOOD, TURNED, GOOD)), CLIP, "scene 0")
    with pytest.raises(BadPrediction, match=message):
        check_prediction(Prediction(labels, 0, poses=poses), CLIP, "scene 0")
