import colorsys
import dataclasses

import numpy as np
import pytest

from datagen.config import Appearance, load_recipe
from datagen.sampling.appearance import hex_color, sample_materials, sample_table

SIZES = [0.1, 0.05, 0.08]


def materials(appearance: Appearance):
    rng = np.random.default_rng(0)
    return [sample_materials(appearance, SIZES, rng) for _ in range(40)]


def hue(color: tuple[float, float, float]) -> float:
    return colorsys.rgb_to_hsv(*color)[0]


def test_same_colour_gives_all_objects_of_a_scene_one_plain_colour():
    scenes = materials(Appearance(style="same-colour"))
    assert all(len(set(scene)) == 1 and scene[0].pattern == "plain" for scene in scenes)
    assert len({scene[0].color for scene in scenes}) == len(scenes)


def test_two_colour_gives_each_object_two_strongly_different_colours():
    for scene in materials(Appearance(style="two-colour")):
        for material in scene:
            assert material.pattern in ("two-tone", "stripes")
            assert np.sqrt(np.sum(np.subtract(material.color, material.color2) ** 2)) > 0.7


def test_textured_gives_each_object_a_texture():
    patterns = {material.pattern for scene in materials(Appearance(style="textured")) for material in scene}
    assert patterns == {"checker", "stripes", "noise", "wood", "dots"}


def test_varied_has_plain_and_patterned_metal_and_other_objects():
    found = [material for scene in materials(Appearance()) for material in scene]
    assert {m.pattern for m in found} == {"plain", "two-tone", "checker", "stripes", "noise", "wood", "dots"}
    assert {m.name for m in found} == {"metal", "rubber", "plastic", "ceramic"}
    assert all((m.metalness == 1) == (m.name == "metal") for m in found)


def test_one_hue_scenes_keep_all_colours_in_a_narrow_band():
    for scene in materials(Appearance(one_hue_share=1.0)):
        hues = [hue(color) for m in scene for color in ((m.color,) if m.pattern == "plain" else (m.color, m.color2))]
        spread = np.abs((np.subtract.outer(hues, hues) + 0.5) % 1 - 0.5)
        assert np.max(spread) <= Appearance().hue_width + 1e-4


def test_one_hue_scenes_are_as_frequent_as_the_recipe_says():
    rng = np.random.default_rng(1)
    appearance = load_recipe("touching").appearance
    narrow = 0
    for _ in range(300):
        hues = [hue(material.color) for material in sample_materials(appearance, SIZES, rng)]
        spread = np.abs((np.subtract.outer(hues, hues) + 0.5) % 1 - 0.5)
        narrow += bool(np.max(spread) <= appearance.hue_width + 1e-4)
    assert narrow == pytest.approx(150, abs=30)


def test_a_palette_is_kept_to():
    appearance = dataclasses.replace(load_recipe("clevr3d").appearance, pattern_share=0.5, one_hue_share=0.5)
    allowed = {tuple(round(x, 6) for x in hex_color(text)) for text in appearance.palette}
    found = [material for scene in materials(appearance) for material in scene]
    assert {material.color for material in found} == allowed
    assert len(allowed) == 8
    seconds = {material.color2 for material in found if material.pattern != "plain"}
    assert seconds
    assert seconds <= allowed


def test_tables_are_of_wood_cloth_tiles_or_paint():
    rng = np.random.default_rng(0)
    tables = [sample_table(Appearance(), rng) for _ in range(60)]
    assert {table.pattern for table in tables} == {"wood", "noise", "checker", "plain"}
    plain = dataclasses.replace(Appearance(), table_textures=False)
    assert {sample_table(plain, rng).pattern for _ in range(30)} == {"plain"}
    assert sample_table(Appearance(table_color="#808080"), rng).color == pytest.approx((0.502,) * 3, abs=1e-3)
