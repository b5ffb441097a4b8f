from dataclasses import replace
from pathlib import Path

import pytest
import torch

from obpose.errors import UsageError
from obpose.scenes import edit
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.codes import CodePrior
from obpose.scenes.priors.flow_prior import save_flow
from obpose.scenes.priors.gaussian import learned_prior, save_gaussian
from obpose.scenes.priors.mixture import Mixture
from obpose.scenes.rendering import Renderer
from obpose.scenes.storage import load_scene, save_scene
from obpose.viewer.scene_io import Sampler, open_path, save_new
from tests.obpose.scenes.small_scenes import CAMERA, dense_flow, equal, some_model, some_scene

MODEL = "obpose-contact--moving--64x64"
PLAIN = {"checkpoint": None, "data": None, "split": "test", "index": 0}


def test_a_dataset_and_a_model_with_data_give_the_same_scene(tiny_dataset: Path):
    by_data = open_path(tiny_dataset, **PLAIN)
    by_model = open_path(Path(MODEL), **PLAIN | {"data": tiny_dataset})
    assert by_data.scene.ids == by_model.scene.ids
    assert by_data.scene.checkpoint == MODEL  # found by the recipe
    assert by_data.clip is not None
    assert by_data.title == "moving, test 0"


def test_a_saved_scene_opens_with_or_without_its_clip(tiny_dataset: Path, tmp_path: Path):
    inferred = open_path(tiny_dataset, **PLAIN)
    save_scene(tmp_path / "saved", inferred.scene)
    assert open_path(tmp_path / "saved", **PLAIN).clip is None
    assert open_path(tmp_path / "saved", **PLAIN | {"data": tiny_dataset}).clip is not None
    half = replace(
        inferred.scene,
        what=inferred.scene.what[:2],
        center=inferred.scene.center[:2],
        rotation=inferred.scene.rotation[:2],
        background=inferred.scene.background[:2],
    )
    save_scene(tmp_path / "half", half)
    with pytest.raises(UsageError, match=r"has 4 frames and 1 view, .* has 2 and 1"):
        open_path(tmp_path / "half", **PLAIN | {"data": tiny_dataset})


def test_missing_and_contradictory_arguments_are_refused(tiny_dataset: Path, tmp_path: Path):
    cases = [
        (tmp_path / "nowhere", {}, "no such folder; expected a dataset"),
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
        open_path(tmp_path / "file", **PLAIN)


def test_a_scene_opens_only_with_its_own_clip(tiny_dataset: Path, tmp_path: Path):
    inferred = open_path(tiny_dataset, **PLAIN | {"index": 1})
    save_scene(tmp_path / "saved", inferred.scene)
    with pytest.raises(UsageError, match="from test scene 1, not from test scene 0; give --split test --scene 1"):
        open_path(tmp_path / "saved", **PLAIN | {"data": tiny_dataset})
    assert open_path(tmp_path / "saved", **PLAIN | {"data": tiny_dataset, "index": 1}).clip is not None
    assert inferred.scene.clip is not None
    elsewhere = replace(inferred.scene, clip=replace(inferred.scene.clip, dataset="another"))
    save_scene(tmp_path / "elsewhere", elsewhere)
    with pytest.raises(UsageError, match=r"not from any scene of .*; give its own dataset with --data"):
        open_path(tmp_path / "elsewhere", **PLAIN | {"data": tiny_dataset, "index": 1})
    save_scene(tmp_path / "older", replace(inferred.scene, clip=None))
    assert open_path(tmp_path / "older", **PLAIN | {"data": tiny_dataset}).clip is not None


def test_the_title_of_the_current_folder_is_its_name(tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tiny_dataset)
    assert open_path(Path(), **PLAIN).title == "moving, test 0"


def test_each_sampler_counts_its_seeds_from_0():
    origin = Origin(some_model(), Path("no-prior-here"), "name", "hash")
    first, second = Sampler(origin), Sampler(origin)
    one, two = first.next(1, (CAMERA,)), first.next(1, (CAMERA,))
    again = second.next(1, (CAMERA,))
    assert torch.equal(one.what, again.what)
    assert not torch.equal(one.what, two.what)
    assert first.seed == 1


def test_scenes_are_sampled_from_the_best_available_prior(tmp_path: Path):
    origin = Origin(some_model(), tmp_path, "name", "hash")
    learned = Sampler(origin).next(1, (CAMERA,))
    save_gaussian(origin, replace(learned_prior(origin), objects=CodePrior(Mixture(*centred_on(3.0)))))
    fitted = Sampler(origin).next(1, (CAMERA,))
    assert float((learned.what - 3).abs().max()) > 1 > float((fitted.what - 3).abs().max())
    assert not fitted.appearance.detail.any()
    save_flow(origin, dense_flow(latent=32))
    assert Sampler(origin).next(1, (CAMERA,)).appearance.detail.any()


def centred_on(value: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    return torch.ones(1), torch.full((1, 32), value), 0.01 * torch.eye(32)[None]


def test_every_save_makes_a_new_folder_and_overwrites_nothing(tmp_path: Path):
    (tmp_path / "out" / "scene-2").mkdir(parents=True)
    scene, renderer = some_scene(), Renderer(some_model())
    folders = [save_new(tmp_path / "out", scene, renderer) for _ in range(2)]
    assert [folder.name for folder in folders] == ["scene-1", "scene-3"]
    assert not list((tmp_path / "out" / "scene-2").iterdir())
    for folder in folders:
        assert equal(load_scene(folder), scene)
        assert (folder / "picture.png").exists()


def test_a_failed_save_leaves_no_folder(tmp_path: Path):
    scene, renderer = some_scene(), Renderer(some_model())
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="is a file"):
        save_new(tmp_path / "file", scene, renderer)
    outside = edit.move(scene, 1, torch.tensor([9.0, 0.0, 0.0]))
    with pytest.raises(UsageError, match="Object 1 would be outside the workspace"):
        save_new(tmp_path / "out", outside, renderer)
    assert not (tmp_path / "out").exists()
