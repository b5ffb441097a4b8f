import re
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from benchmark.clips import ClipSequence
from benchmark.commands.cli import main
from benchmark.models import pose_file as stored_poses
from benchmark.models.adapters.predictions import PredictionFolder
from benchmark.models.interface import Clip, Poses, Prediction
from benchmark.ranking.standings import load_standings, pooled
from benchmark.results.labels import write_labels
from benchmark.results.run_folder import load_runs, load_scenes
from datagen.errors import CorruptFile, DatagenError, UsageError
from datagen.storage.reader import Dataset, Split
from tests.worlds.traced import write_dataset

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
    return main([str(argument) for argument in arguments])


@pytest.mark.parametrize("write", [write_npz, write_png, write_hdf5])
def test_every_layout_holds_the_same(scenes: Split, truths: list[np.ndarray], tmp_path: Path, write: Writer):
    write(tmp_path, truths)
    folder = PredictionFolder(tmp_path, 0)
    folder.check(scenes.labels_shape)
    for index, clip in enumerate(ClipSequence(scenes)):
        prediction = folder.read(index, clip)
        np.testing.assert_array_equal(prediction.labels, truths[index])
        assert prediction.background_slot == 0


def test_the_index_of_poses_is_read_once_until_the_file_changes(
    scenes: Split, truths: list[np.ndarray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    write, spoil, _ = in_poses("")
    write(tmp_path, truths)
    spoil(tmp_path)
    folder, clip = PredictionFolder(tmp_path, 0), ClipSequence(scenes)[0]
    with monkeypatch.context() as patch:
        folder.read(0, clip)
        patch.setattr(stored_poses, "_check_index", lambda *_: pytest.fail("read again"))
        found = folder.read(1, clip).poses
        assert found is not None
        assert np.argwhere(np.isfinite(found.center).all(axis=-1)).tolist() == [[1, 1, 2]]
    change_hdf5(tmp_path, poses__index=[[1, 0, 0, 1], [0, 1, 1, 2]])
    found = folder.read(1, clip).poses
    assert found is not None
    assert np.argwhere(np.isfinite(found.center).all(axis=-1)).tolist() == [[0, 0, 1]]


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
    assert entry.mean("msc_fg") == 0.5


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


@pytest.mark.parametrize(
    ("write", "scored"), [(write_npz, "00001.npz"), (write_png, "00001/view0_frame000.png")], ids=["npz", "png"]
)
def test_only_files_that_are_scored_are_part_of_the_digest(
    truths: list[np.ndarray], tmp_path: Path, write: Writer, scored: str
):
    write(tmp_path, truths)
    folder, split = PredictionFolder(tmp_path), tmp_path / "test"
    before = folder.digest()
    (split / ".hidden").mkdir()
    for name in (".DS_Store", "README.txt", "._00000.npz", "preview.png", ".hidden/0.png"):
        (split / name).write_text("not scored")
    if write is write_png:
        for name in (".DS_Store", "._view0_frame000.png", "notes.txt"):
            (split / "00000" / name).write_text("not scored")
    assert folder.digest() == before
    (split / scored).write_bytes(b"other label maps")
    assert folder.digest() != before


@pytest.mark.slow
def test_mended_predictions_replace_failed_rows_unasked(data: Path, truths: list[np.ndarray], tmp_path: Path):
    for name in ("a", "b"):
        write_npz(tmp_path / name, truths)
    broken = tmp_path / "b" / "test" / "00001.npz"
    whole = broken.read_bytes()
    np.savez(broken, labels=np.full_like(truths[1], 300, np.int64))
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
        ("labels.h5", b"nonsense", CorruptFile, "damaged or not an HDF5 file"),
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


def test_images_of_a_bad_kind_are_named(clip: Clip, truths: list[np.ndarray], tmp_path: Path):
    write_png(tmp_path, truths)
    path = tmp_path / "test" / "00000" / "view0_frame001.png"
    Image.new("L", (3, 3)).save(path)
    with pytest.raises(UsageError, match="has 3 x 3 pixels; expected 64 x 48"):
        PredictionFolder(tmp_path).read(0, clip)
    for mode in ("RGB", "LA", "1", "I;16"):
        Image.new(mode, (64, 48)).save(path)
        with pytest.raises(UsageError, match=f"mode {mode}, "):
            PredictionFolder(tmp_path).read(0, clip)
    Image.new("L", (64, 48)).save(path, "JPEG")
    with pytest.raises(CorruptFile, match="no image; expected PNG"):
        PredictionFolder(tmp_path).read(0, clip)


def test_grey_images_of_fewer_bits_are_refused(clip: Clip, truths: list[np.ndarray], tmp_path: Path):
    """Readers of images stretch their labels: of four bits, label 3 would become 51."""
    write_png(tmp_path, truths)
    path = tmp_path / "test" / "00000" / "view0_frame001.png"
    height, width = clip.depth.shape[2:]
    rows = b"".join(b"\0" + bytes(width // 2) for _ in range(height))
    header = struct.pack(">IIBBBBB", width, height, 4, 0, 0, 0, 0)
    parts = [(b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")]
    chunks = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    ]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    with pytest.raises(UsageError, match="mode L, 4 bits; expected eight bits"):
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


def test_labels_out_of_range_are_a_failed_row(data: Path, truths: list[np.ndarray], tmp_path: Path):
    """Headers do not tell what the labels are."""
    write_npz(tmp_path / "mine", [truths[0], np.full(truths[1].shape, -1)])
    assert run_cli("--predictions", tmp_path / "mine", "--data", data, "--out", tmp_path / "out") == 3
    (row,) = load_runs(tmp_path / "out")
    assert row.status == "failed"
    assert "00001.npz: the labels of scene 1 go from -1 to -1; expected 0 to 255" in row.reason


def add_npz(folder: Path, **arrays: object) -> None:
    """Add arrays to the first scene, or replace some."""
    path = folder / "test" / "00000.npz"
    with np.load(path) as file:
        np.savez(path, **{**file, **arrays})


def change_hdf5(folder: Path, **arrays: object) -> None:
    """Add arrays to the file of all scenes, or replace some; None removes one."""
    with h5py.File(folder / "labels.h5", "a") as file:
        for name, values in arrays.items():
            name = name.replace("__", "/")
            if name in file:
                del file[name]
            if values is not None:
                file[name] = values


def copy_image(folder: Path, name: str) -> None:
    scene = folder / "test" / "00001"
    (scene / name).write_bytes((scene / "view0_frame000.png").read_bytes())


def labels(*shape: int, dtype: type = np.uint8) -> np.ndarray:
    return np.zeros(shape, dtype)


Fault = tuple[Writer, Callable[[Path], None], str]


def in_hdf5(message: str, **arrays: object) -> Fault:
    return write_hdf5, lambda folder: change_hdf5(folder, **arrays), message


def in_poses(message: str, **arrays: object) -> Fault:
    """Two poses as runs keep them, some of their arrays replaced."""
    good = {"index": [[0, 0, 0, 1], [1, 1, 1, 2]], "center": np.ones((2, 3)), "rotation": np.array([np.eye(3)] * 2)}
    return in_hdf5(message, **{f"poses__{name}": values for name, values in {**good, **arrays}.items()})


def in_npz(message: str, **arrays: object) -> Fault:
    return write_npz, lambda folder: add_npz(folder, **arrays), message


def more_npz(message: str, name: str) -> Fault:
    return write_npz, lambda folder: np.savez(folder / "test" / name, labels=0), message


def more_images(message: str, name: str) -> Fault:
    return write_png, lambda folder: copy_image(folder, name), message


FAULTS = [
    in_hdf5("(3, 2, 2, 48, 64); expected", labels=labels(3, 2, 2, 48, 64)),
    in_hdf5("(2, 4, 2, 48, 64); expected", labels=labels(2, 4, 2, 48, 64)),
    in_hdf5("(2, 2, 2, 96, 64); expected", labels=labels(2, 2, 2, 96, 64)),
    in_hdf5("(2, 2, 48, 64); expected", labels=labels(2, 2, 48, 64)),
    in_hdf5("`labels` is float64", labels=labels(2, 2, 2, 48, 64, dtype=float)),
    in_hdf5("has no array `labels`", labels=None),
    in_hdf5("is int64 of shape (1,); expected integers of shape (2,), [scene]", background_slots=[0]),
    in_hdf5("of shape (); expected", background_slots=0),
    in_hdf5("`background_slots` is float64", background_slots=[0.0, 1.7]),
    in_hdf5("`background_slots` is bool", background_slots=[True, False]),
    in_hdf5("`background_slots` holds -1; expected 0 to 255", background_slots=[0, -1]),
    in_hdf5("`background_slots` holds 256", background_slots=[0, 256]),
    in_hdf5("background_slots has type object", background_slots=["a", "b"]),
    in_hdf5("background_slots is a group", background_slots=None, background_slots__x=1),
    in_hdf5("holds an array `background_slot`", background_slot=[0, 0]),
    in_hdf5("holds an array `center`", center=[0, 0]),
    (write_hdf5, lambda folder: (folder / "test").mkdir(), "holds both labels.h5 and test/"),
    in_poses("names view -1 in row 1; expected 0 to 1", index=[[0, 0, 0, 1], [1, 1, -1, 2]]),
    in_poses("names scene 2 in row 1; expected 0 to 1", index=[[0, 0, 0, 1], [2, 1, 1, 2]]),
    in_poses("names label 1099511627776", index=[[0, 0, 0, 1], [1, 1, 1, 2**40]]),
    in_poses("names one label of an image twice", index=[[0, 0, 0, 1]] * 2),
    in_poses("poses/index has type float64", index=np.ones((2, 4))),
    in_poses("expected (poses, 4)", index=[[0, 0, 0]] * 2),
    in_poses("poses/index is missing", index=None),
    in_poses("rotation without center", center=None),
    in_poses("expected (2, 3), as index has", center=np.ones((3, 3))),
    in_poses("scene 1: of frame 1, view 1, label 2 the center is infinite", center=[[0, 0, 0.5], [0, np.inf, 0]]),
    in_poses("center is partly nan", center=[[0, 0, 0.5], [0, np.nan, 0]]),
    in_poses("not a rotation matrix", rotation=np.ones((2, 3, 3))),
    more_npz("00002.npz: these label maps belong to nothing that is scored; the dataset has 2 scenes", "00002.npz"),
    more_npz("000001.npz: these label maps", "000001.npz"),
    more_npz("scene_3.npz: these label maps", "scene_3.npz"),
    (write_npz, lambda folder: (folder / "test" / "00001").mkdir(), "and the folder of the same name are both there"),
    in_npz("`labels` is uint8 of shape (4, 2, 48, 64); expected", labels=labels(4, 2, 48, 64)),
    in_npz("`labels` is float64", labels=labels(2, 2, 48, 64, dtype=float)),
    in_npz("of shape (1,); expected integers of shape (), one number", background_slot=[0]),
    in_npz("`background_slot` holds -1", background_slot=-1),
    in_npz("holds an array `background_slots`", background_slots=[0, 0]),
    in_npz("center is infinite", center=np.full((2, 2, 3, 3), np.inf)),
    in_npz("rotation without center", rotation=np.ones((2, 2, 3, 3, 3))),
    in_npz("center of poses <U1", center=np.full((2, 2, 3, 3), "a")),
    more_images("scored; clips have frames 0 to 1 and views 0 to 1", "view0_frame002.png"),
    more_images("view2_frame000.png: these label maps", "view2_frame000.png"),
    more_images("frame0.PNG: these label maps", "frame0.PNG"),
    (write_png, lambda folder: (folder / "test" / "00002").mkdir(), "00002: these label maps"),
]


@pytest.mark.parametrize(("write", "spoil", "message"), FAULTS)
def test_what_does_not_fit_the_split_is_refused_before_anything_is_scored(
    scenes: Split,
    truths: list[np.ndarray],
    tmp_path: Path,
    write: Writer,
    spoil: Callable[[Path], object],
    message: str,
):
    write(tmp_path / "mine", truths)
    folder = PredictionFolder(tmp_path / "mine")
    folder.check(scenes.labels_shape)
    spoil(tmp_path / "mine")
    with pytest.raises((UsageError, CorruptFile), match=re.escape(message)) as error:
        folder.check(scenes.labels_shape)
    assert str(tmp_path / "mine") in str(error.value)


def test_hidden_files_and_notes_are_let_be(scenes: Split, truths: list[np.ndarray], tmp_path: Path):
    write_png(tmp_path, truths)
    copy_image(tmp_path, "._view0_frame000.png")
    for name in ("README.txt", ".DS_Store", "._00000.npz", "00000/notes.txt"):
        (tmp_path / "test" / name).write_bytes(b"")
    PredictionFolder(tmp_path).check(scenes.labels_shape)


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


def test_claims_of_millions_of_poses_are_refused_by_their_headers(
    scenes: Split, truths: list[np.ndarray], tmp_path: Path
):
    write_npz(tmp_path / "npz", truths)
    add_npz(tmp_path / "npz", center=np.zeros((2, 2, 500_000, 3)))
    write_hdf5(tmp_path / "hdf5", truths)
    with h5py.File(tmp_path / "hdf5" / "labels.h5", "a") as file:
        file.create_dataset("poses/index", (10**7, 4), np.int64, chunks=(1000, 4))  # a few bytes on disk

    tracemalloc.start()
    with pytest.raises(UsageError, match=r"center of poses has shape .* expected at most 3072 numbers"):
        PredictionFolder(tmp_path / "npz").check(scenes.labels_shape)
    with pytest.raises(DatagenError, match="poses/index has 10000000 rows; expected at most 2048"):
        PredictionFolder(tmp_path / "hdf5").check(scenes.labels_shape)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4e6
