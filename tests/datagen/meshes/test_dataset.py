"""A user's meshes through the commands: generate, verify, render, regenerate, card, and files that have changed."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datagen.commands.cli import main
from datagen.inspect.dataset_card import card
from datagen.inspect.stats import summary
from datagen.meshes.distance import MeshSolid
from datagen.meshes.library import open_library
from datagen.meshes.raycast import first_hits
from datagen.storage.reader import Dataset
from datagen.verify import verify_record
from tests.worlds.meshes import BOX, SIDES, triangles, write_obj, write_ply


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two meshes, and a dataset of two scenes whose splits share no mesh."""
    root = tmp_path_factory.mktemp("meshes")
    write_obj(root / "assets")
    colors = np.full((8, 3), [20, 60, 220])
    write_ply(root / "assets" / "blue.ply", BOX * [60, 50, 30], triangles(), colors)
    patch = pytest.MonkeyPatch()
    patch.setenv("OBPOSE_CACHE", str(root / "cache"))
    arguments = ["--assets", str(root / "assets"), "--recipe", "static", "--split", "train=1,test=1", "--workers", "1"]
    shares = ["--assets-split", "50/0/50", "--resolution", "64x64", "--out", str(root / "data")]
    assert main([*arguments, *shares]) == 0
    patch.undo()
    return root


def test_the_dataset_is_verified_against_the_meshes(folder: Path):
    assert main(["verify", str(folder / "data"), "--assets", str(folder / "assets"), "--workers", "1"]) == 0


def test_the_texture_shows_on_the_right_sides(folder: Path):
    dataset = Dataset(folder / "data")
    library = open_library(dataset.spec["assets"], folder / "assets")
    assert library
    split = next(name for name in ("train", "test") if library.names(name) == ["box"])
    record = dataset.split(split)[0]
    k, pose = record["camera/K"][0], record["camera/world_from_camera"][0]
    solid = MeshSolid(BOX * [0.05, 0.04, 0.06], triangles(), closed=True)
    checked = set()
    for row in range(int(record["objects/count"])):
        rows, columns = np.nonzero(record["segmentation"][0, 0] == row + 1)
        rays = np.linalg.solve(k, np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))])).T @ pose[:3, :3].T
        w, x, y, z = record["poses/quaternion_wxyz"][0, row].astype(float)
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        origins = np.tile((pose[:3, 3] - record["poses/position"][0, row]) @ turn, (len(rays), 1))
        side = first_hits(solid, origins, rays @ turn)[1] // 2
        for number in set(side.tolist()):
            shown = np.median(record["rgb"][0, 0][rows, columns][side == number], axis=0)
            if np.count_nonzero(side == number) > 20:
                # Shading keeps which channels are strong.
                np.testing.assert_array_equal(shown > shown.max() / 2, np.array(SIDES[number]) > 100)
                checked.add(number)
    assert len(checked) > 2


def test_each_mesh_is_stored_with_file_hash_and_scale(folder: Path):
    assets = Dataset(folder / "data").spec["assets"]
    assert {asset["file"]: asset["scale"] for asset in assets} == {"box.obj": 1.0, "blue.ply": 0.001}
    card = (folder / "data" / "README.md").read_text()
    assert "No shape of the test split occurs in training" in card
    assert all(asset["sha256"] in card for asset in assets)


def test_a_card_compares_test_shapes_only_with_those_of_training(folder: Path):
    spec, figures = Dataset(folder / "data").spec, summary(folder / "data")
    assert "No shape of the test split occurs in training" in card(spec, figures, {"train": {"a"}, "test": {"b"}})
    assert "of the test split" not in card(spec, figures, {"train": {"a"}, "val": {"a"}, "test": set()})


def test_a_moved_object_contradicts_its_mesh(folder: Path):
    dataset = Dataset(folder / "data")
    library = open_library(dataset.spec["assets"], folder / "assets")
    record = {name: array.copy() for name, array in dataset.split("train")[0].items()}
    assert verify_record(record, ("simulation", "pixels"), meshes=library) == []
    record["poses/position"][0, 0] += [0.001, 0.0, 0.0]
    assert {"surface", "boxes"} <= {
        finding.check for finding in verify_record(record, ("simulation", "pixels"), meshes=library)
    }
    assert [finding.check for finding in verify_record(record, ("simulation", "pixels"))] == ["description"]


def test_rendering_needs_no_hulls_and_regenerating_is_exact(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("OBPOSE_CACHE", str(tmp_path / "empty"))
    arguments = ["--assets", str(folder / "assets")]
    out = ["--out", str(tmp_path / "small"), "--resolution", "32x32", "--workers", "1"]
    assert main(["render", "--from", str(folder / "data"), *arguments, *out]) == 0
    assert not (tmp_path / "empty").exists()
    assert main(["regenerate", str(folder / "data"), *arguments]) == 0


@pytest.mark.parametrize(
    "command",
    [
        ["verify", "{data}"],
        ["regenerate", "{data}"],
        ["render", "--from", "{data}", "--out", "{out}"],
        ["export", "--format", "bop", "{data}", "--out", "{out}"],
    ],
)
def test_other_files_are_rejected(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]):
    words = [word.format(data=folder / "data", out=tmp_path / "out") for word in command]
    write_obj(tmp_path / "other")
    write_ply(tmp_path / "other" / "blue.ply", BOX * [60, 50, 30], triangles())
    for assets, message in (
        ([], "--assets"),
        (["--assets", str(tmp_path / "other")], r"blue\.ply is not the file"),
        (["--assets", str(tmp_path)], r"is missing"),
    ):
        assert main([*words, *assets]) == 2
        assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "out").exists()
    # An equal mesh with another texture is another mesh.
    write_ply(tmp_path / "other" / "blue.ply", BOX * [60, 50, 30], triangles(), np.full((8, 3), [20, 60, 220]))
    Image.new("RGB", (96, 64)).save(tmp_path / "other" / "box.png")
    assert main([*words, "--assets", str(tmp_path / "other")]) == 2
    assert re.search(r"box\.obj is not the file", capsys.readouterr().err)


def test_meshes_are_exported_as_models_to_which_poses_refer(folder: Path, tmp_path: Path):
    bop, back = tmp_path / "bop", tmp_path / "back"
    arguments = ["--assets", str(folder / "assets"), "--out", str(bop)]
    assert main(["export", "--format", "bop", str(folder / "data"), *arguments]) == 0
    assert len(list((bop / "models").glob("obj_*.ply"))) == 2
    assert main(["import", "--format", "bop", str(bop), "--group", "views", "--out", str(back)]) == 0
    assert main(["verify", str(back), "--workers", "1"]) == 0
    for split in ("train", "test"):
        original, record = (Dataset(place).split(split)[0] for place in (folder / "data", back))
        rows = slice(0, int(original["objects/count"]))
        for name in ("boxes/box_3d", "poses/position"):
            assert np.max(np.abs(original[name][:, rows] - record[name][:, rows])) < 1e-4


def test_a_split_without_meshes_has_no_scenes(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = ["--out", str(tmp_path / "out"), "--assets-split", "1/0/1"]
    assert main(["--assets", str(folder / "assets"), "--split", "train=1,val=1", *out]) == 2
    assert "Split val has scenes, but no mesh" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_recipe_of_meshes_says_that_it_needs_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["--recipe", "ycb-moving", "--scenes", "1", "--out", str(tmp_path / "out")]) == 2
    assert "--assets" in capsys.readouterr().err
    assert main(["--scenes", "1", "--unit", "mm", "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()
