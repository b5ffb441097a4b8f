from collections.abc import Callable
from pathlib import Path

import h5py
import jaxtyping
import numpy as np
import pytest
from PIL import Image

from benchmark.adapters.predictions import PredictionFolder
from benchmark.cli import main
from benchmark.clips import ClipSequence
from benchmark.interface import Clip, Poses, Prediction
from benchmark.labels import write_labels
from benchmark.results import load_runs, load_scenes, pooled
from benchmark.standings import load_standings
from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.storage import Dataset, Split
from tests.fabricated import write_dataset

Writer = Callable[[Path, list[np.ndarray]], None]


def write_npz(folder: Path, maps: list[np.ndarray]) -> None:
    (folder / "test").mkdir(parents=True)
    for scene, labels in enumerate(maps):
        np.savez(folder / "test" / f"{scene:05d}.npz", labels=labels, background_slot=0)


def write_png(folder: Path, maps: list[np.ndarray]) -> None:
    for scene, labels in enumerate(maps):
        place = folder / "test" / f"{scene:05d}"
        place.mkdir(parents=True)
        for frame, views in enumerate(labels):
            for view, image in enumerate(views):
                Image.fromarray(image.astype(np.uint8)).save(place / f"view{view}_frame{frame:03d}.png")


def write_hdf5(folder: Path, maps: list[np.ndarray]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with h5py.File(folder / "labels.h5", "w") as file:
        file["labels"] = np.stack(maps)
        file["background_slots"] = np.zeros(len(maps), np.uint8)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("predictions") / "data", scenes=2, frames=2, views=2)


@pytest.fixture(scope="module")
def scenes(data: Path) -> Split:
    return Dataset(data).split("test")


@pytest.fixture(scope="module")
def clip(scenes: Split) -> Clip:
    return ClipSequence(scenes)[0]


@pytest.fixture(scope="module")
def truths(scenes: Split) -> list[np.ndarray]:
    return [scene["segmentation"] for scene in scenes]


def run_cli(*arguments: object) -> int:
    with pytest.raises(SystemExit) as exit_:
        main([str(argument) for argument in arguments])
    return int(exit_.value.code or 0)


@pytest.mark.parametrize("write", [write_npz, write_png, write_hdf5])
def test_every_layout_holds_the_same(scenes: Split, truths: list[np.ndarray], tmp_path: Path, write: Writer):
    write(tmp_path, truths)
    folder = PredictionFolder(tmp_path, 0)
    folder.check(len(scenes))
    for index, clip in enumerate(ClipSequence(scenes)):
        prediction = folder.read(index, clip)
        np.testing.assert_array_equal(prediction.labels, truths[index])
        assert prediction.background_slot == 0


def test_a_folder_is_scored_without_code(data: Path, truths: list[np.ndarray], tmp_path: Path):
    write_png(tmp_path / "mine", truths)
    assert run_cli("--predictions", tmp_path / "mine", "--data", data, "--out", tmp_path / "out") == 0
    (row,) = load_runs(tmp_path / "out")
    assert (row.key.model, row.kind, row.status, row.n_scenes) == ("mine", "predictions", "ok", 2)
    table = load_scenes(tmp_path / "out", row)
    assert [pooled(table, name) for name in ("ari", "ari_fg", "msc_fg", "miou_bg")] == [1.0] * 4


@pytest.mark.slow
def test_several_folders_are_several_seeds(data: Path, truths: list[np.ndarray], tmp_path: Path):
    write_npz(tmp_path / "a", truths)
    write_npz(tmp_path / "b", [np.zeros_like(labels) for labels in truths])
    folders = [tmp_path / "a", tmp_path / "b"]
    assert run_cli("--predictions", *folders, "--name", "mine", "--data", data, "--out", tmp_path / "out") == 0
    rows = load_runs(tmp_path / "out")
    assert [(row.key.model, row.key.seed) for row in rows] == [("mine", 0), ("mine", 1)]
    assert [pooled(load_scenes(tmp_path / "out", row), "msc_fg") for row in rows] == [1.0, 0.0]
    (entry,) = load_standings(tmp_path / "out")
    assert entry.best_known("msc_fg") == 0.5


@pytest.mark.slow
def test_the_label_maps_of_a_run_are_predictions(data: Path, tmp_path: Path):
    assert run_cli("--model", "plane-dbscan", "--seeds", 1, "--data", data, "--out", tmp_path / "out") == 0
    (labels,) = (tmp_path / "out" / "labels").iterdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "labels.h5").write_bytes(labels.read_bytes())
    assert run_cli("--predictions", tmp_path / "mine", "--data", data, "--out", tmp_path / "out") == 0
    mine, model = (load_scenes(tmp_path / "out", row) for row in load_runs(tmp_path / "out"))
    for name, values in model.items():
        np.testing.assert_array_equal(mine[name], values)


@pytest.mark.slow
def test_changed_predictions_are_another_row(data: Path, truths: list[np.ndarray], tmp_path: Path, capsys):
    write_npz(tmp_path / "mine", truths)
    command = ("--predictions", tmp_path / "mine", "--data", data, "--out", tmp_path / "out")
    assert run_cli(*command) == 0
    np.savez(tmp_path / "mine" / "test" / "00000.npz", labels=np.zeros_like(truths[0]))
    assert run_cli(*command) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert run_cli(*command, "--overwrite") == 0
    (row,) = load_runs(tmp_path / "out")
    assert pooled(load_scenes(tmp_path / "out", row), "msc_fg") == 0.5


@pytest.mark.slow
def test_mended_predictions_replace_failed_rows_unasked(data: Path, truths: list[np.ndarray], tmp_path: Path):
    for name in ("a", "b"):
        write_npz(tmp_path / name, truths)
    broken = tmp_path / "b" / "test" / "00001.npz"
    whole = broken.read_bytes()
    broken.write_bytes(b"nonsense")
    command = ("--predictions", tmp_path / "a", tmp_path / "b", "--name", "mine", "--data", data)
    assert run_cli(*command, "--out", tmp_path / "out") == 3
    assert [row.status for row in load_runs(tmp_path / "out")] == ["ok", "failed"]
    broken.write_bytes(whole)
    assert run_cli(*command, "--out", tmp_path / "out") == 0
    assert [(row.key.seed, row.status) for row in load_runs(tmp_path / "out")] == [(0, "ok"), (1, "ok")]


def test_a_file_that_names_its_background_overrules_the_flag(clip: Clip, truths: list[np.ndarray], tmp_path: Path):
    write_npz(tmp_path / "npz", truths)
    write_png(tmp_path / "png", truths)
    assert PredictionFolder(tmp_path / "npz", 3).read(0, clip).background_slot == 0
    assert PredictionFolder(tmp_path / "png", 3).read(0, clip).background_slot == 3
    assert PredictionFolder(tmp_path / "png").read(0, clip).background_slot is None


def test_palette_images_give_their_numbers(clip: Clip, truths: list[np.ndarray], tmp_path: Path):
    write_png(tmp_path, truths)
    for path in tmp_path.rglob("*.png"):
        with Image.open(path) as image:
            image = image.convert("L")
        image.putpalette([255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 9, 9])
        image.save(path)
    with Image.open(path) as image:
        assert image.mode == "P"
    np.testing.assert_array_equal(PredictionFolder(tmp_path).read(0, clip).labels, truths[0])


@pytest.mark.parametrize(
    ("file", "content", "error", "message"),
    [
        ("test/00000.npz", b"nonsense", CorruptFile, "damaged or no NPZ"),
        ("test/00000.npz", b"", CorruptFile, "damaged or no NPZ"),
        ("labels.h5", b"nonsense", CorruptFile, "damaged or no HDF5"),
        ("test/00000/view0_frame000.png", b"nonsense", CorruptFile, "damaged or no image"),
        ("test/00000/other.png", b"", UsageError, "view0_frame000.png is missing"),
    ],
)
def test_bad_files_are_named(clip: Clip, tmp_path: Path, file: str, content: bytes, error: type[DatagenError], message):
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_bytes(content)
    with pytest.raises(error, match=message):
        PredictionFolder(tmp_path).read(0, clip)


def test_an_array_that_cannot_be_unpacked_is_named(clip: Clip, tmp_path: Path):
    path = tmp_path / "test" / "00000.npz"
    path.parent.mkdir()
    np.savez_compressed(path, labels=np.zeros(clip.depth.shape, dtype=np.uint8))
    content = bytearray(path.read_bytes())
    # The first byte of the packed array, after the header of its entry: a kind of block that does not exist.
    content[30 + len("labels.npy") + int.from_bytes(content[28:30], "little")] = 0xFF
    path.write_bytes(content)
    with pytest.raises(CorruptFile, match="damaged or no NPZ"):
        PredictionFolder(tmp_path).read(0, clip)


def test_what_is_not_of_the_layout_is_named(clip: Clip, tmp_path: Path):
    np.savez(tmp_path / "x.npz", other=np.zeros(3))
    (tmp_path / "test").mkdir()
    (tmp_path / "x.npz").rename(tmp_path / "test" / "00000.npz")
    with pytest.raises(UsageError, match="no array `labels`"):
        PredictionFolder(tmp_path).read(0, clip)
    write_hdf5(tmp_path / "short", [np.zeros(clip.depth.shape)])
    with pytest.raises(UsageError, match="no `labels` of scene 1"):
        PredictionFolder(tmp_path / "short").read(1, clip)


def test_images_of_a_bad_kind_are_named(clip: Clip, truths: list[np.ndarray], tmp_path: Path):
    write_png(tmp_path, truths)
    path = tmp_path / "test" / "00000" / "view0_frame001.png"
    Image.new("L", (3, 3)).save(path)
    with pytest.raises(UsageError, match="different sizes"):
        PredictionFolder(tmp_path).read(0, clip)
    Image.new("RGB", (3, 3)).save(path)
    with pytest.raises(UsageError, match="mode RGB"):
        PredictionFolder(tmp_path).read(0, clip)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--predictions", "{nowhere}"], "is no folder"),
        (["--predictions", "{empty}"], "no label maps of scene 0"),
        (["--predictions", "{mine}", "--name", "plane-dbscan"], "is the name of a model"),
        (["--predictions", "{mine}", "{mine}/../mine"], "is given twice"),
        (["--predictions", "{mine}", "--model", "plane-dbscan"], "Name what to score"),
    ],
)
def test_bad_requests_get_one_line(
    data: Path, truths: list[np.ndarray], tmp_path: Path, capsys, arguments: list[str], message: str
):
    write_npz(tmp_path / "mine", truths)
    (tmp_path / "empty").mkdir()
    places = {name: tmp_path / name for name in ("mine", "empty", "nowhere")}
    arguments = [argument.format(**places) for argument in arguments]
    assert run_cli(*arguments, "--data", data, "--out", tmp_path / "out") == 2
    errors = capsys.readouterr().err
    assert errors.count("\n") == 1
    assert message in errors


@pytest.mark.slow
def test_maps_of_another_size_are_a_failed_row(data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    write_npz(tmp_path / "mine", [np.zeros((2, 2, 3, 3), np.uint8)] * 2)
    assert run_cli("--predictions", tmp_path / "mine", "--data", data, "--out", tmp_path / "out") == 3
    (row,) = load_runs(tmp_path / "out")
    assert row.status == "failed"
    assert "expected integers of shape (2, 2, 48, 64)" in row.reason


def test_poses_may_lie_beside_the_labels(clip: Clip, truths: list[np.ndarray], tmp_path: Path):
    center = np.random.default_rng(0).normal(size=(*clip.depth.shape[:2], 4, 3))
    write_npz(tmp_path / "plain", truths)
    assert PredictionFolder(tmp_path / "plain").read(0, clip).poses is None
    (tmp_path / "npz" / "test").mkdir(parents=True)
    np.savez(tmp_path / "npz" / "test" / "00000.npz", labels=truths[0], center=center)
    found = PredictionFolder(tmp_path / "npz").read(0, clip).poses
    assert found is not None
    np.testing.assert_array_equal(found.center, center)
    assert found.rotation is None
    (tmp_path / "own").mkdir()
    with write_labels(tmp_path / "own" / "labels.h5", 2, tmp_path) as writer:
        writer.put(0, Prediction(truths[0], 0))
        writer.put(1, Prediction(truths[1], 0, poses=Poses(center)))
    again = PredictionFolder(tmp_path / "own").read(1, clip).poses
    assert again is not None
    np.testing.assert_array_equal(again.center, center)
