from pathlib import Path

import pytest
import torch

from obpose.scenes.appearance.light import no_light
from obpose.scenes.appearance.table_texture import no_texture, patch_of, texture_like
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors import tables
from obpose.scenes.priors.tables import find_tables, no_tables
from tests.obpose.scenes.small_scenes import some_model, some_scene, some_tables
from tests.worlds.observations import table_scene


def test_a_table_has_the_light_and_a_pattern_like_that_of_one_clip():
    source, drawn = some_tables(3), set()
    for seed in range(12):
        light, texture = source.draw(torch.Generator().manual_seed(seed))
        ((place,),) = (source.lights == light).all(dim=1).nonzero().tolist()
        generator = torch.Generator().manual_seed(seed)
        torch.randint(3, (), generator=generator)
        assert torch.equal(texture, texture_like(source.patches[place], generator))
        drawn.add(place)
    assert drawn == {0, 1, 2}


def test_where_there_are_none_there_is_no_light_and_no_pattern():
    light, texture = no_tables(torch.zeros(())).draw(torch.Generator())
    assert torch.equal(light, no_light())
    assert torch.equal(texture, no_texture())


def test_they_are_those_of_fitted_scenes(monkeypatch: pytest.MonkeyPatch):
    scene, asked = some_scene(), []

    def infer(origin: Origin, clip: object, *, refinements: int) -> object:
        asked.append(refinements)
        return scene

    monkeypatch.setattr(tables, "infer_scene", infer)
    of = Origin(some_model(), Path("folder"), "name", "hash")
    found = find_tables(of, [table_scene(batch=1, frames=1)] * 2, refinements=7)
    assert asked == [7, 7]
    assert torch.equal(found.lights, scene.appearance.light.expand(2, 4))
    assert torch.equal(found.patches[1], patch_of(scene.appearance.texture))
