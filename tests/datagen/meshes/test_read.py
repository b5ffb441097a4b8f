"""Files of all kinds become triangles with colours; bad ones are refused with their name and a remedy."""

import json
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from datagen.errors import DatagenError
from datagen.meshes.build import place
from datagen.meshes.named_files import content_hash
from datagen.meshes.read import LINEAR, read_mesh
from datagen.storage.safe_io import parse_json
from tests.worlds.meshes import (
    BOX,
    SIDES,
    triangles,
    write_obj,
    write_ply,
    write_stl,
    write_textured_glb,
    write_textured_ply,
)


def test_an_obj_with_a_texture(tmp_path: Path):
    raw = read_mesh(tmp_path, write_obj(tmp_path).name)
    assert (len(raw.faces), len(raw.images), raw.has_colors, raw.parts) == (12, 1, True, 1)
    x, y = (np.mean(raw.uv, axis=1) * [96, 64]).astype(int).T
    center = np.mean(raw.vertices[raw.faces], axis=1) / np.max(raw.vertices, axis=0)
    axis = np.argmax(np.abs(center), axis=1)
    side = 2 * axis + (center[np.arange(12), axis] > 0)
    np.testing.assert_array_equal(raw.images[0][y, x], np.array(SIDES)[side])
    # Kd is 0, but the texture is what viewers show.
    np.testing.assert_array_equal(raw.colors, 1.0)


def test_a_ply_with_vertex_colours(tmp_path: Path):
    colors = np.arange(24).reshape(8, 3) * 10
    raw = read_mesh(tmp_path, write_ply(tmp_path / "a.ply", 40 * BOX, triangles(), colors).name)
    np.testing.assert_allclose(raw.colors, LINEAR[colors][triangles()], rtol=1e-6)
    assert raw.images == ()


def test_a_ply_of_bop_names_its_texture_in_a_comment(tmp_path: Path):
    path = write_textured_ply(tmp_path / "obj_000001.ply", 40 * BOX, triangles())
    raw = read_mesh(tmp_path, path.name)
    assert raw.images[0][0, 0].tolist() == [250, 120, 10]
    np.testing.assert_allclose(raw.uv, 0.5)
    path.with_suffix(".png").write_bytes((path.with_suffix(".png")).read_bytes() + b"0")
    assert content_hash(tmp_path, path.name) != raw.sha256


def test_a_glb_keeps_the_transforms_of_its_parts(tmp_path: Path):
    scene = trimesh.Scene()
    scene.add_geometry(
        trimesh.creation.box((0.1, 0.1, 0.1)), transform=trimesh.transformations.translation_matrix([1, 2, 3])
    )
    scene.add_geometry(trimesh.creation.box((0.2, 0.1, 0.1)))
    scene.export(tmp_path / "two.glb")
    raw = read_mesh(tmp_path, "two.glb")
    assert raw.parts == 2
    np.testing.assert_allclose(np.max(raw.vertices, axis=0), [1.05, 2.05, 3.05], atol=1e-6)


def test_a_glb_has_its_texture_inside(tmp_path: Path):
    raw = read_mesh(tmp_path, write_textured_glb(tmp_path / "a.glb").name)
    assert raw.images[0][0, 0].tolist() == [250, 120, 10]


def test_the_hash_covers_the_texture(tmp_path: Path):
    write_obj(tmp_path)
    before = content_hash(tmp_path, "box.obj")
    assert before == read_mesh(tmp_path, "box.obj").sha256
    Image.new("RGB", (96, 64)).save(tmp_path / "box.png")
    assert content_hash(tmp_path, "box.obj") != before


def test_a_missing_texture_is_a_problem_and_no_failure(tmp_path: Path):
    write_obj(tmp_path, texture="gone.png")
    raw = read_mesh(tmp_path, "box.obj")
    assert raw.problems == ("gone.png is missing",)
    assert raw.images == ()


def test_names_of_files_that_cannot_be_are_missing_and_few_are_listed(tmp_path: Path):
    path = write_obj(tmp_path)
    names = ["a\0.mtl", 5000 * "a", *(f"{number}.mtl" for number in range(9))]
    path.write_text("".join(f"mtllib {name}\n" for name in names) + path.read_text())
    problems = read_mesh(tmp_path, "box.obj").problems
    assert (len(problems), problems[-1]) == (6, "6 more files are missing")


def test_a_texture_that_is_a_link_to_itself_is_missing(tmp_path: Path):
    write_obj(tmp_path, texture="loop.png")
    (tmp_path / "loop.png").unlink(missing_ok=True)
    (tmp_path / "loop.png").symlink_to("loop.png")
    assert read_mesh(tmp_path, "box.obj").problems == ("loop.png is missing",)


def test_texture_coordinates_without_a_material_give_no_colours(tmp_path: Path):
    path = write_obj(tmp_path)
    path.write_text(path.read_text().replace("mtllib box.mtl", "mtllib  "))
    raw = read_mesh(tmp_path, "box.obj")
    assert (raw.images, raw.has_colors, raw.problems) == ((), False, ())


def outside(folder: Path) -> str:
    write_obj(folder.parent / "secret")
    write_obj(folder, texture="../secret/box.png")
    return "box.obj"


def outside_absolute(folder: Path) -> str:
    write_obj(folder, texture="/etc/passwd")
    return "box.obj"


def outside_by_link(folder: Path) -> str:
    write_obj(folder.parent / "secret")
    folder.mkdir()
    (folder / "box.obj").symlink_to(folder.parent / "secret" / "box.obj")
    return "box.obj"


def huge_texture(folder: Path) -> str:
    write_obj(folder)
    Image.new("1", (20_000, 20_000)).save(folder / "box.png")
    return "box.obj"


def damaged_texture(folder: Path) -> str:
    write_obj(folder)
    (folder / "box.png").write_bytes(b"no image")
    return "box.obj"


def damaged_other_texture(folder: Path) -> str:
    write_obj(folder, texture="box.webp")
    (folder / "box.webp").write_bytes(b"no image")
    return "box.obj"


def damaged_embedded_texture(folder: Path) -> str:
    path = write_textured_glb(folder / "a.glb")
    path.write_bytes(path.read_bytes().replace(b"\x89PNG", b"\0PNG"))
    return path.name


def huge_embedded_texture(folder: Path) -> str:
    path = write_textured_glb(folder / "a.glb")
    data = path.read_bytes()
    start = data.index(b"IHDR")
    head = b"IHDR" + 2 * (20_000).to_bytes(4, "big") + data[start + 12 : start + 17]
    path.write_bytes(data[:start] + head + zlib.crc32(head).to_bytes(4, "big") + data[start + 21 :])
    return path.name


def change_header(path: Path, change: Callable[[dict[str, Any]], object]) -> str:
    """Change the JSON part of a GLB file."""
    data = path.read_bytes()
    end = 20 + int.from_bytes(data[12:16], "little")
    header = parse_json(data[20:end].decode())
    change(header)
    head = json.dumps(header).ljust(end + 80).encode()
    chunk = len(head).to_bytes(4, "little") + b"JSON" + head
    path.write_bytes(data[:8] + (12 + len(chunk) + len(data) - end).to_bytes(4, "little") + chunk + data[end:])
    return path.name


def compressed(folder: Path) -> str:
    path = write_textured_glb(folder / "a.glb")
    return change_header(path, lambda header: header.update(extensionsRequired=["KHR_draco_mesh_compression"]))


def huge_array(folder: Path) -> str:
    path = write_textured_glb(folder / "a.glb")
    return change_header(path, lambda header: header["accessors"].append({"count": 10**9}))


def list_as_type(folder: Path) -> str:
    path = write_textured_glb(folder / "a.glb")
    return change_header(path, lambda header: header["accessors"][0].update(type=[None]))


def texture_elsewhere(folder: Path) -> str:
    path = write_textured_glb(folder / "a.glb")
    return change_header(path, lambda header: header.update(images=[{"uri": "../a.png"}]))


def empty(folder: Path) -> str:
    folder.mkdir()
    (folder / "a.stl").write_bytes(b"")
    return "a.stl"


def garbage(folder: Path) -> str:
    folder.mkdir()
    (folder / "a.glb").write_bytes(b"glTF" + bytes(range(200)))
    return "a.glb"


def without_faces(folder: Path) -> str:
    return write_ply(folder / "a.ply", BOX, np.zeros((0, 3), int)).name


def not_a_number(folder: Path) -> str:
    return write_ply(folder / "a.ply", np.where(BOX[3] == BOX, np.nan, BOX), triangles()).name


def infinite(folder: Path) -> str:
    return write_ply(folder / "a.ply", np.where(BOX[3] == BOX, np.inf, BOX), triangles()).name


def two_coordinates(folder: Path) -> str:
    folder.mkdir()
    (folder / "a.obj").write_text("v 0 0\nv 0 1\nv 1 0\nf 1 2 3\n")
    return "a.obj"


def enormous(folder: Path) -> str:
    return write_ply(folder / "a.ply", np.where(BOX[3] == BOX, 1e30, BOX), triangles()).name


def wrong_corner(folder: Path) -> str:
    return write_ply(folder / "a.ply", BOX, triangles() + 3).name


def five_million_faces(folder: Path) -> str:
    path = write_stl(folder / "a.stl", np.zeros((1, 3, 3)))
    data = bytearray(path.read_bytes())
    data[80:84] = (5_000_000).to_bytes(4, "little")
    with path.open("wb") as file:
        file.write(data)
        file.truncate(84 + 50 * 5_000_000)
    return "a.stl"


def truncated(folder: Path) -> str:
    path = write_stl(folder / "a.stl", BOX[triangles()])
    path.write_bytes(path.read_bytes()[:-70])
    return path.name


def soup(folder: Path) -> str:
    return write_stl(folder / "a.stl", np.random.default_rng(0).uniform(size=(100, 3, 3)) * 0.1).name


def flat(folder: Path) -> str:
    return write_ply(folder / "a.ply", BOX * [1, 1, 0], triangles()).name


def single_point(folder: Path) -> str:
    return write_ply(folder / "a.ply", BOX * 0, triangles()).name


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (outside, "outside of"),
        (outside_absolute, "outside of"),
        (outside_by_link, "outside of"),
        (huge_texture, "too many pixels"),
        (damaged_texture, r"box\.png is damaged"),
        (damaged_other_texture, r"box\.webp is damaged"),
        (damaged_embedded_texture, r"a\.glb: image 0 is damaged"),
        (huge_array, r"a\.glb has an array of 1,000,000,000 rows"),
        (list_as_type, r"a\.glb is damaged or no mesh \(a value has another type than expected\)"),
        (texture_elsewhere, r"a\.glb names '\.\./a\.png', which lies outside of"),
        (compressed, r"a\.glb needs KHR_draco_mesh_compression"),
        (huge_embedded_texture, r"a\.glb: image 0 has too many pixels"),
        (empty, r"a\.stl is empty"),
        (garbage, r"a\.glb is damaged or no mesh"),
        (without_faces, "no triangles"),
        (not_a_number, "NaN"),
        (infinite, "infinite"),
        (two_coordinates, "three coordinates"),
        (enormous, r"beyond 1e\+09"),
        (wrong_corner, r"a\.ply"),
        (five_million_faces, "5,000,000 faces"),
        (truncated, r"a\.stl is truncated: 2 of its triangles are missing"),
        (soup, "loose triangles"),
        (flat, "is flat"),
        (single_point, "single point"),
    ],
)
def test_bad_files_are_refused_with_their_name(tmp_path: Path, make: Callable[[Path], str], words: str):
    folder = tmp_path / "meshes"
    file = make(folder)
    with pytest.raises(DatagenError, match=words) as refused:
        place(read_mesh(folder, file), 1.0, "z", str(folder / file))
    assert str(folder) in str(refused.value)
