"""Names, units and splits of a folder of meshes."""

from pathlib import Path

import numpy as np
import pytest

from datagen.errors import UsageError
from datagen.meshes.library import split_meshes
from datagen.meshes.survey import Reading, examine, find_files, fits, make_library, name_files
from datagen.meshes.units import Up, guess_unit, guess_up, rotation_to_z
from tests.worlds.meshes import BOX, triangles, write_obj, write_ply, write_stl


def test_ycb_folders_give_one_mesh_each(tmp_path: Path):
    for kind in ("google_16k", "tsdf", "poisson"):
        write_obj(tmp_path / "025_mug" / kind).rename(tmp_path / "025_mug" / kind / "textured.obj")
    write_ply(tmp_path / "models" / "obj_000001.ply", 40 * BOX, triangles())
    files = find_files(tmp_path)
    assert files == ["025_mug/google_16k/textured.obj", "models/obj_000001.ply"]
    assert name_files(files) == ["025_mug", "obj_000001"]
    assert name_files(["a/textured.obj", "b/a.stl"]) == ["a", "a-2"]


def test_names_fit_with_and_without_prefixes():
    assert fits("mesh:025_mug", "ycb_025_mug")
    assert fits("mesh:065-a_cups", "065-a_cups")
    assert not fits("mesh:025_mug", "024_bowl")


@pytest.mark.parametrize(
    ("suffix", "longest", "unit", "certain"),
    [
        (".obj", 0.2, "m", True),
        (".ply", 92.0, "mm", True),
        (".glb", 92.0, "m", True),
        (".stl", 11.4, "mm", False),
        (".stl", 1.6, "m", False),
        (".stl", 0.001, "m", False),
    ],
)
def test_the_unit_is_guessed_or_doubted(suffix: str, longest: float, unit: str, certain: bool):
    guess = guess_unit(suffix, longest)
    assert (guess.unit, guess.certain) == (unit, certain)


@pytest.mark.parametrize(("up", "axis"), [("x", 0), ("y", 1), ("z", 2)])
def test_the_upward_axis_becomes_z(up: Up, axis: int):
    rotation = rotation_to_z(up)
    np.testing.assert_array_equal(rotation[:, axis], [0, 0, 1])
    np.testing.assert_array_equal(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == 1


@pytest.mark.parametrize(("suffix", "up"), [(".glb", "y"), (".obj", "z"), (".ply", "z"), (".stl", "z")])
def test_y_is_up_in_gltf_and_z_in_other_files(suffix: str, up: str):
    assert guess_up(suffix) == up


def test_unit_up_and_scale_decide_the_size(tmp_path: Path):
    write_stl(tmp_path / "a.stl", (BOX * [0.5, 1, 2])[triangles()])
    one = examine(tmp_path, "a.stl", "a", Reading(unit="in", up="y", scale=0.5), hulls=False)
    assert one.size == pytest.approx([0.0127, 0.0508, 0.0254])
    large = examine(tmp_path, "a.stl", "a", Reading(unit="m"), hulls=False)
    assert large.warnings == ["longest side 400.0 cm, more than 30 cm"]


def test_what_cannot_be_used_is_named(tmp_path: Path):
    write_stl(tmp_path / "unsure.stl", (5 * BOX)[triangles()])
    with pytest.raises(UsageError, match=r"unit of unsure\.stl .* --unit"):
        make_library(tmp_path, Reading())
    (tmp_path / "empty.stl").write_bytes(b"")
    with pytest.raises(UsageError, match=r"empty\.stl is empty"):
        make_library(tmp_path, Reading(unit="mm"))
    with pytest.raises(UsageError, match="holds none of"):
        make_library(tmp_path, Reading(), categories=["mesh:025_mug"])
    with pytest.raises(UsageError, match="names no mesh"):
        make_library(tmp_path, Reading(), categories=["box"])


def test_splits_share_no_mesh_and_all_get_one():
    hashes = [f"{number:064x}" for number in range(20)]
    splits = split_meshes(hashes, (80, 10, 10))
    assert sorted(splits.values()) == [("test",)] * 2 + [("train",)] * 16 + [("val",)] * 2
    assert split_meshes(hashes[::-1], (80, 10, 10)) == splits
    assert sorted(split_meshes(hashes[:3], (98, 1, 1)).values()) == [("test",), ("train",), ("val",)]
    assert set(split_meshes(hashes, (1, 0, 1)).values()) == {("train",), ("test",)}
    with pytest.raises(UsageError, match="at least 3 different meshes"):
        split_meshes(hashes[:2], (80, 10, 10))
