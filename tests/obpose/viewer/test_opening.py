from dataclasses import replace
from pathlib import Path

import pytest

from obpose.errors import UsageError
from obpose.scenes.storage import save_scene
from obpose.viewer.opening import kind_of, open_path

MODEL = "obpose-sharp--moving--64x64"
PLAIN = {"checkpoint": None, "data": None, "split": "test", "index": 0}


def test_a_dataset_and_a_model_with_data_show_the_same(tiny_dataset: Path):
    by_data = open_path(tiny_dataset, **PLAIN)
    by_model = open_path(Path(MODEL), **PLAIN | {"data": tiny_dataset})
    assert by_data.scene.ids == by_model.scene.ids
    assert by_data.scene.checkpoint == MODEL  # found by the recipe
    assert by_data.clip is not None
    assert by_data.title == "moving, test 0"


def test_a_saved_scene_is_shown_with_or_without_its_clip(tiny_dataset: Path, tmp_path: Path):
    inferred = open_path(tiny_dataset, **PLAIN)
    save_scene(tmp_path / "saved", inferred.scene)
    assert open_path(tmp_path / "saved", **PLAIN).clip is None
    assert open_path(tmp_path / "saved", **PLAIN | {"data": tiny_dataset}).clip is not None
    half = replace(
        inferred.scene,
        what=inferred.scene.what[:5],
        center=inferred.scene.center[:5],
        rotation=inferred.scene.rotation[:5],
        background=inferred.scene.background[:5],
    )
    save_scene(tmp_path / "half", half)
    with pytest.raises(UsageError, match=r"has 10 frames and 1 view, .* has 5 and 1"):
        open_path(tmp_path / "half", **PLAIN | {"data": tiny_dataset})


def test_what_is_missing_or_contradicts_itself_is_told(tiny_dataset: Path, tmp_path: Path):
    cases = [
        (tmp_path / "nowhere", {}, "no such folder; expected one of a dataset"),
        (tmp_path, {}, "holds no dataset"),
        (Path(MODEL), {}, "say with --data DIR"),
        (Path(MODEL), {"data": tiny_dataset, "checkpoint": MODEL}, "leave out --checkpoint"),
        (tiny_dataset, {"data": tiny_dataset}, "leave out --data"),
        (tiny_dataset, {"checkpoint": "none"}, "--checkpoint none: no such folder"),
        (tiny_dataset, {"index": 2}, "--scene 2: expected 0 to 1"),
    ]
    for path, given, message in cases:
        with pytest.raises(UsageError, match=message):
            open_path(path, **PLAIN | given)
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="is a file; expected"):
        kind_of(tmp_path / "file")


def test_a_scene_is_shown_beside_its_own_clip_only(tiny_dataset: Path, tmp_path: Path):
    inferred = open_path(tiny_dataset, **PLAIN | {"index": 1})
    save_scene(tmp_path / "saved", inferred.scene)
    with pytest.raises(UsageError, match="of test scene 1, not of test scene 0; give --split test --scene 1"):
        open_path(tmp_path / "saved", **PLAIN | {"data": tiny_dataset})
    assert open_path(tmp_path / "saved", **PLAIN | {"data": tiny_dataset, "index": 1}).clip is not None
    assert inferred.scene.clip is not None
    elsewhere = replace(inferred.scene, clip=replace(inferred.scene.clip, dataset="another"))
    save_scene(tmp_path / "elsewhere", elsewhere)
    with pytest.raises(UsageError, match=r"not of any in .*; give the dataset that it is of with --data"):
        open_path(tmp_path / "elsewhere", **PLAIN | {"data": tiny_dataset, "index": 1})
    save_scene(tmp_path / "older", replace(inferred.scene, clip=None))
    assert open_path(tmp_path / "older", **PLAIN | {"data": tiny_dataset}).clip is not None


def test_the_current_folder_has_a_name(tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tiny_dataset)
    assert open_path(Path(), **PLAIN).title == "moving, test 0"
