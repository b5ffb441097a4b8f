import json
from pathlib import Path

import numpy as np
import pytest
import torch

from obpose.creation.storage import load_scene, save_scene
from obpose.errors import CorruptFile, DatagenError, UsageError
from tests.obpose.creation.scenes import CAMERA, equal, some_scene


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
        {"objects": [1, 1, 2]},
        {"objects": [0, 1, 2]},
        {"objects": "abc"},
        {"images": []},
        {"images": [[0, 3]]},
        {"images": 3},
        {"model": None, "objects": None},
    ],
)
def test_facts_that_do_not_fit_are_damage(tmp_path: Path, change: dict[str, object]):
    save_scene(tmp_path, some_scene())
    facts = json.loads((tmp_path / "scene.json").read_text())
    (tmp_path / "scene.json").write_text(json.dumps({**facts, **change}))
    with pytest.raises(CorruptFile, match="is damaged"):
        load_scene(tmp_path)


@pytest.mark.parametrize("name", ["scene.json", "scene.safetensors"])
@pytest.mark.parametrize("content", [b"", b"[]", b"\xff\x00" * 20])
def test_other_files_are_damage(tmp_path: Path, name: str, content: bytes):
    save_scene(tmp_path, some_scene())
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CorruptFile, match="is damaged"):
        load_scene(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises((CorruptFile, UsageError)):
        load_scene(tmp_path)


def test_numbers_that_are_none_are_damage(tmp_path: Path):
    scene = some_scene()
    scene.center[0, 0, 0] = torch.nan
    save_scene(tmp_path, scene)
    with pytest.raises(CorruptFile, match="is damaged"):
        load_scene(tmp_path)


def test_a_scene_takes_no_other_one_s_place(tmp_path: Path):
    save_scene(tmp_path / "scene", some_scene())
    with pytest.raises(UsageError, match="is there already and not empty"):
        save_scene(tmp_path / "scene", some_scene(seed=1))
    assert equal(load_scene(tmp_path / "scene"), some_scene())


def test_a_save_that_fails_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(path: Path, _data: bytes) -> None:
        raise DatagenError(f"Cannot write {path}")

    monkeypatch.setattr("obpose.creation.pictures.write_whole", full)
    with pytest.raises(DatagenError, match=r"picture\.png"):
        save_scene(tmp_path / "scene", some_scene(), np.zeros((2, 2, 3), np.uint8))
    assert not list(tmp_path.iterdir())
