from dataclasses import replace
from pathlib import Path

import pytest
from safetensors.torch import load_file, save_file

from obpose.errors import CorruptFile, UsageError
from obpose.model.build import build_obpose
from obpose.scenes.model_ref import load_origin, origin_of
from obpose.storage.checkpoint import save_model
from obpose.variants import make_config
from tests.obpose.scenes.small_scenes import some_model, some_scene


def trained(folder: Path, variant: str = "obpose") -> str:
    model = some_model() if variant == "obpose" else build_obpose(make_config(variant))
    save_model(folder, model.state_dict(), model.config, {})
    return str(folder)


def test_a_scene_finds_its_model_and_refuses_others(tmp_path: Path):
    place = trained(tmp_path / "model")
    scene = replace(some_scene(model=load_origin(place).hash), checkpoint=place)
    assert origin_of(scene).name == place
    weights = load_file(tmp_path / "model" / "model.safetensors")
    name = next(iter(weights))
    save_file({**weights, name: weights[name] + 1}, tmp_path / "model" / "model.safetensors", {"info": "{}"})
    (tmp_path / "model" / "model.sha256").unlink()
    with pytest.raises(UsageError, match="made with other weights"):
        origin_of(scene)


def test_a_model_that_was_moved_can_be_named(tmp_path: Path):
    scene = replace(some_scene(model=load_origin(trained(tmp_path / "a")).hash), checkpoint=str(tmp_path / "a"))
    (tmp_path / "a").rename(tmp_path / "b")
    with pytest.raises(UsageError, match=r"was not found.*Give its place with --checkpoint"):
        origin_of(scene)
    assert origin_of(scene, str(tmp_path / "b")).folder == tmp_path / "b"


def test_latents_of_other_sizes_than_the_model_s_are_damage(tmp_path: Path):
    place = trained(tmp_path / "model")
    scene = replace(some_scene(model=load_origin(place).hash), checkpoint=place)
    with pytest.raises(CorruptFile, match="its latents have 31 and 32 values, those of its model 32"):
        origin_of(replace(scene, what=scene.what[..., 1:]))


@pytest.mark.parametrize("variant", ["obpose-none", "slot-attention"])
def test_objects_without_poses_cannot_be_edited(tmp_path: Path, variant: str):
    with pytest.raises(UsageError, match=r"give one of obpose, obpose-loc, .*, obpose-contact\.$"):
        load_origin(trained(tmp_path, variant))
