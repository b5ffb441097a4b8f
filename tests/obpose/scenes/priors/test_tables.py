import torch

from obpose.scenes.appearance.light import no_light
from obpose.scenes.appearance.table_texture import no_texture, texture_like
from obpose.scenes.priors.tables import no_tables
from tests.obpose.scenes.small_scenes import some_tables


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
