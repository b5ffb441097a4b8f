import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from obpose.errors import CorruptFile, DatagenError, UsageError
from obpose.scenes.scene import ClipName
from obpose.scenes.storage import load_scene, save_scene
from tests.obpose.scenes.small_scenes import CAMERA, equal, some_scene


@pytest.mark.parametrize("objects", [0, 3])
def test_a_stored_scene_is_the_same(tmp_path: Path, objects: int):
    scene = some_scene(objects=objects)
    save_scene(tmp_path / "new" / "scene", scene)
    found = load_scene(tmp_path / "new" / "scene")
    assert equal(found, scene)
    assert (found.model, found.checkpoint) == (scene.model, scene.checkpoint)
    assert torch.equal(found.cameras[0].k, CAMERA.k)
    assert (found.cameras[0].width, found.cameras[0].height) == (16, 12)


def test_no_scene_and_later_ones_are_told(tmp_path: Path):
    with pytest.raises(UsageError, match=r"holds no scene: there is no scene\.json"):
        load_scene(tmp_path)
    save_scene(tmp_path, some_scene())
    facts = json.loads((tmp_path / "scene.json").read_text())
    (tmp_path / "scene.json").write_text(json.dumps({**facts, "version": 9}))
    with pytest.raises(UsageError, match="version 9, expected 1"):
        load_scene(tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"objects": [1, 2]},
        {"objects": [0, 1, 2]},
        {"objects": "abc"},
        {"images": [[0, 3]]},
        {"objects": [1, 2, 2**31]},
        {"images": [[10**12, 3]]},
        {"clip": {"dataset": "abc", "split": "test", "index": -1}},
        {"clip": {"dataset": "abc", "split": "elsewhere", "index": 0}},
        {"clip": {"dataset": "abc", "split": "test", "index": 0, "more": 1}},
        {"clip": None},
        {"objects": list(range(1, 1002))},
        {"images": [[16, 12], [16, 12]]},
        {"model": 3},
        {"checkpoint": " "},
        {"version": True},
        {"more": 1},
    ],
)
def test_facts_that_do_not_fit_are_damage(tmp_path: Path, change: dict[str, object]):
    save_scene(tmp_path, some_scene())
    facts = json.loads((tmp_path / "scene.json").read_text())
    (tmp_path / "scene.json").write_text(json.dumps({**facts, **change}))
    with pytest.raises(CorruptFile, match="is damaged"):
        load_scene(tmp_path)


@pytest.mark.parametrize("name", ["version", "model", "checkpoint", "objects", "images"])
def test_facts_that_are_missing_are_damage(tmp_path: Path, name: str):
    save_scene(tmp_path, some_scene())
    facts = json.loads((tmp_path / "scene.json").read_text())
    del facts[name]
    (tmp_path / "scene.json").write_text(json.dumps(facts))
    with pytest.raises(CorruptFile, match=rf"scene\.json is damaged .required field missing @ \$\.{name}"):
        load_scene(tmp_path)


@pytest.mark.parametrize("name", ["scene.json", "scene.safetensors"])
@pytest.mark.parametrize("content", [b"", b"[]", b"\xff\x00" * 20])
def test_other_files_are_damage(tmp_path: Path, name: str, content: bytes):
    save_scene(tmp_path, some_scene())
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CorruptFile, match="is damaged"):
        load_scene(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises((CorruptFile, UsageError), match=rf"there is no {name}|{name} is missing"):
        load_scene(tmp_path)


EMPTY = {"what": (3, 8), "center": (3, 3), "rotation": (3, 3, 3), "background": (8,)}
CAMERAS = {"k": CAMERA.k[None], "world_from_camera": CAMERA.world_from_camera[None]}


@pytest.mark.parametrize(
    "change",
    [
        {"center": torch.full((2, 3, 3), torch.nan)},
        {"k": torch.full((1, 3, 3), torch.nan)},
        {"k": CAMERAS["k"].mT.contiguous()},
        {"world_from_camera": CAMERAS["world_from_camera"] * torch.inf},
        {"what": torch.zeros(2, 3, 32, dtype=torch.float64)},
        {"rotation": torch.diag(torch.tensor([1.0, 1.0, -1.0])).repeat(2, 3, 1, 1)},
        {"detail": torch.zeros(3, 8, 8, 8, 4)},
        {"detail": torch.full((3, 16, 16, 16, 4), torch.nan)},
        {"world_from_camera": torch.diag(torch.tensor([0.0, 0.0, 0.0, 1.0]))[None]},
        {"half_extent": torch.full((3, 3), -0.1)},
        {"light": torch.tensor([torch.nan, 0.0, 0.0, 0.0])},
        {"light": torch.zeros(4, dtype=torch.float64)},
        {"light": torch.tensor([0.6, 0.0, 0.8, 1.5])},
        {"light": torch.tensor([0.6, 0.0, 0.9, 0.5])},
        {"more": torch.zeros(1)},
        {"center": None},
        {"background": torch.zeros(2, 8, dtype=torch.bfloat16)},
        {"what": torch.zeros(2, 4, 8)},
        {name: torch.zeros(0, *shape) for name, shape in EMPTY.items()},
    ],
)
def test_arrays_that_no_scene_has_are_damage(tmp_path: Path, change: dict[str, torch.Tensor | None]):
    save_scene(tmp_path, some_scene())
    tensors = {name: value.clone() for name, value in load_file(tmp_path / "scene.safetensors").items()} | change
    save_file({name: value for name, value in tensors.items() if value is not None}, tmp_path / "scene.safetensors")
    with pytest.raises(CorruptFile, match="is damaged"):
        load_scene(tmp_path)


def test_facts_nested_without_end_are_damage(tmp_path: Path):
    save_scene(tmp_path, some_scene())
    (tmp_path / "scene.json").write_text("[" * 100_000)
    with pytest.raises(CorruptFile, match="is damaged"):
        load_scene(tmp_path)


def test_a_scene_knows_its_clip_and_older_ones_do_not(tmp_path: Path):
    name = ClipName("abc", "val", 0)
    save_scene(tmp_path / "new", replace(some_scene(), clip=name))
    assert load_scene(tmp_path / "new").clip == name
    save_scene(tmp_path / "old", some_scene())
    assert "clip" not in json.loads((tmp_path / "old" / "scene.json").read_text())
    assert load_scene(tmp_path / "old").clip is None


@pytest.mark.parametrize("name", ["detail", "alone", "half_extent", "light", "pattern"])
def test_scenes_of_older_versions_have_less(tmp_path: Path, name: str):
    save_scene(tmp_path, some_scene())
    tensors = load_file(tmp_path / "scene.safetensors")
    nothing = torch.zeros_like(tensors.pop(name))
    save_file(tensors, tmp_path / "scene.safetensors")
    field = {"pattern": "texture", "alone": "own_scale"}.get(name, name)
    assert equal(load_scene(tmp_path), some_scene().with_appearance(**{field: nothing}))


def test_the_model_s_folder_is_found_from_everywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "model").mkdir()
    monkeypatch.chdir(tmp_path)
    for place, stored in (("model", str(tmp_path / "model")), ("obpose--moving--64x64", "obpose--moving--64x64")):
        save_scene(tmp_path / f"of-{place}", replace(some_scene(), checkpoint=place))
        assert load_scene(tmp_path / f"of-{place}").checkpoint == stored


def test_a_scene_takes_no_other_one_s_place(tmp_path: Path):
    save_scene(tmp_path / "scene", some_scene())
    with pytest.raises(UsageError, match="already exists and is not empty"):
        save_scene(tmp_path / "scene", some_scene(seed=1))
    assert equal(load_scene(tmp_path / "scene"), some_scene())


def test_a_save_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(path: Path, _data: bytes) -> None:
        raise DatagenError(f"Cannot write {path}")

    monkeypatch.setattr("obpose.scenes.pictures.write_atomically", full)
    with pytest.raises(DatagenError, match=r"picture\.png"):
        save_scene(tmp_path / "scene", some_scene(), np.zeros((2, 2, 3), np.uint8))
    assert not list(tmp_path.iterdir())


def test_what_could_not_be_read_again_is_not_written(tmp_path: Path):
    scene = some_scene()
    with pytest.raises(
        UsageError,
        match=r"holds NaN, values above 1e\+06, more than 1000 objects, or arrays that do not fit",
    ):
        save_scene(tmp_path / "new", replace(scene, what=torch.full_like(scene.what, torch.inf)))
    assert not (tmp_path / "new").exists()
