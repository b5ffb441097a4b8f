from pathlib import Path

import pytest
import torch

from obpose.errors import UsageError
from obpose.scenes import edit
from obpose.scenes.rendering import Renderer
from obpose.scenes.storage import load_scene
from obpose.viewer.saving import save_new
from tests.obpose.scenes.small_scenes import equal, some_model, some_scene


def test_every_save_is_a_new_folder_and_nothing_is_overwritten(tmp_path: Path):
    (tmp_path / "out" / "scene-2").mkdir(parents=True)
    scene, renderer = some_scene(), Renderer(some_model())
    folders = [save_new(tmp_path / "out", scene, renderer) for _ in range(2)]
    assert [folder.name for folder in folders] == ["scene-1", "scene-3"]
    assert not list((tmp_path / "out" / "scene-2").iterdir())
    for folder in folders:
        assert equal(load_scene(folder), scene)
        assert (folder / "picture.png").exists()


def test_what_cannot_be_saved_leaves_nothing(tmp_path: Path):
    scene, renderer = some_scene(), Renderer(some_model())
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="is a file"):
        save_new(tmp_path / "file", scene, renderer)
    outside = edit.move(scene, 1, torch.tensor([9.0, 0.0, 0.0]))
    with pytest.raises(UsageError, match="Object 1 would be outside the workspace"):
        save_new(tmp_path / "out", outside, renderer)
    assert not (tmp_path / "out").exists()
