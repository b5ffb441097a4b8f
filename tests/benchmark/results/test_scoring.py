import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.clips import ClipSequence, read_true_poses
from benchmark.execution.jobs import segment_split
from benchmark.metrics.box_overlap import box_corners
from benchmark.metrics.poses import POSE_METRICS
from benchmark.models.classical.boxes import OracleVisibleBoxes, OracleVisibleMeans
from benchmark.models.interface import Clip, Poses, Prediction
from benchmark.results.labels import read_poses
from benchmark.results.run_folder import load_runs
from benchmark.results.scoring import rescore, score_labels
from datagen.errors import CorruptFile
from datagen.storage.reader import Dataset, Split
from tests.paths import ROOT
from tests.worlds import rendered
from tests.worlds.imported import import_balls
from tests.worlds.runs import MODELS, write_runs


@pytest.fixture
def run(tmp_path: Path) -> Path:
    write_runs(tmp_path, scenes=2, seeds=1, models={name: MODELS[name] for name in ("merger", "splitter")})
    return tmp_path / "run"


def test_scores_come_out_as_before_and_progress_is_shown(run: Path, tmp_path: Path):
    before = {path: path.read_bytes() for path in (run / "scenes").iterdir()}
    for path in before:
        path.write_text("spoiled")
    heard: list[str] = []

    def progress(items, title: str):
        heard.append(f"{title} {len(items)}")
        return items

    assert rescore(run, load_runs(run), [tmp_path / "moving", tmp_path / "static"], progress=progress) == 4
    assert {path: path.read_bytes() for path in (run / "scenes").iterdir()} == before
    assert heard == ["scoring rows 4"]


def test_label_maps_of_another_dataset_are_named(run: Path, tmp_path: Path):
    path = next((run / "labels").glob("moving--merger--*"))
    with h5py.File(path, "a") as file:
        del file["labels"]
        file["labels"] = np.zeros((1, 1, 1, 4, 4), np.uint8)
    with pytest.raises(
        CorruptFile, match=rf"{path.name} does not fit the dataset's scenes: it has label maps of shape"
    ):
        rescore(run, load_runs(run), [tmp_path / "moving", tmp_path / "static"])


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = rendered.record(rendered.scene(views=2), resolution=(48, 48))
    return rendered.write_dataset(tmp_path_factory.mktemp("scoring") / "data", [scene, scene])


@pytest.fixture(scope="module")
def scenes(data: Path) -> Split:
    return Dataset(data).split("train")


def test_true_poses_are_those_of_the_scene(scenes: Split):
    """Objects slide and turn as `rendered.trajectory` has them; the first is a box of 12 x 8 x 6 cm."""
    clip = ClipSequence(scenes, uses_labels=True)[0]
    assert clip.truth is not None
    true = read_true_poses(scenes, 0, clip, clip.truth)
    for frame in range(3):
        places = np.array([place for _, place in rendered.STANDING]) + np.array([0.004 * frame, 0.0, 0.0])
        np.testing.assert_allclose(true.box_center[frame], places, atol=1e-4)
        turned = Rotation.from_rotvec([0, 0, 0.3 + 0.2 * frame]).as_matrix()
        np.testing.assert_allclose(true.rotation[frame], [turned] * 3, atol=1e-6)
        in_object_frame = box_corners(true.box(frame, 0)) @ turned
        np.testing.assert_allclose(np.ptp(in_object_frame, axis=0), [0.12, 0.08, 0.06], atol=1e-4)


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


def test_poses_of_imported_scenes_are_unknown_and_not_scored(tmp_path: Path):
    dataset = import_balls(tmp_path)
    found = score(OracleVisibleBoxes().segment, dataset.split("test"), dataset.folder, tmp_path / "out")
    assert read_poses(tmp_path / "out" / "labels.h5") is not None
    assert found["ari_fg"] == 1
    assert not set(POSE_METRICS) & set(found)


GROWTH = """
import os, sys
from pathlib import Path
from benchmark.clips import ClipSequence
from benchmark.execution.jobs import segment_split
from benchmark.machine import resident_mib
from benchmark.models.classical.boxes import OracleVisibleBoxes
from benchmark.results import scoring
from datagen.storage.reader import Dataset
folder, out = Path(sys.argv[1]), Path(sys.argv[2])
scenes, model, line, used = Dataset(folder).split("train"), OracleVisibleBoxes(), scoring.scene_line, []
def watch(call):
    used.append(resident_mib(os.getpid()))
    return call
segment_split(lambda _, clip: watch(model.segment)(clip), ClipSequence(scenes, uses_labels=True), out / "l.h5", folder)
scoring.scene_line = lambda *arguments: watch(line)(*arguments)
scoring.score_labels(out / "l.h5", scenes, out, "row")
count = len(scenes)
print(used[count - 1] - used[768], used[-1] - used[count + 768])  # buffers are full by then
"""


@pytest.mark.slow
def test_memory_stays_flat_over_2000_scenes_with_poses(tmp_path: Path):
    folder = rendered.write_shards(tmp_path / "set", 32)
    command = [sys.executable, "-c", GROWTH, str(folder), str(tmp_path)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    segmented, scored = map(float, result.stdout.split())
    print(f"1280 scenes: segmenting {segmented:.2f} MiB, scoring {scored:.2f} MiB")
    # Kept rows and poses took 1.8 and 4.9 MiB per 1000 scenes.
    assert segmented < 1.3
    assert scored < 3.2
