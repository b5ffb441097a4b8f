import dataclasses
import json

import pytest

from datagen import catalog
from datagen.config import (
    Layout,
    Recipe,
    Rig,
    load_recipe,
    names_without_meshes,
    recipe_from_dict,
    recipe_names,
    recipe_to_dict,
)
from datagen.errors import UsageError

VIDEO = ("moving", "touching", "same-colour", "two-colour", "textured", "noisy", "mixed", "cluttered")
STILL = ("desk", "static", "clevr3d", "multishape")
MESHES = ("ycb-moving", "ycb-static")


def test_the_recipes_are_those_of_the_documentation():
    assert sorted(VIDEO + STILL + MESHES) == recipe_names()
    assert sorted(VIDEO + STILL) == names_without_meshes()


@pytest.mark.parametrize("name", recipe_names())
def test_a_recipe_survives_the_way_through_json(name: str):
    recipe = load_recipe(name)
    text = json.dumps(recipe_to_dict(recipe))
    assert recipe_from_dict(json.loads(text)) == recipe
    assert json.dumps(recipe_to_dict(recipe_from_dict(json.loads(text)))) == text
    assert recipe.name == name
    assert recipe.description


def test_desk_draws_its_cameras_and_its_objects_from_ranges():
    recipe = load_recipe("desk")
    assert (recipe.frames, recipe.views, recipe.resolution) == (1, 1, (160, 120))
    assert (recipe.objects.minimum, recipe.objects.maximum) == (1, 12)
    assert recipe.sensor.enabled
    parts = [recipe.for_scene(index) for index in range(2)]
    assert [part.layout.placement for part in parts] == ["scattered", "stacked"]
    assert all(part.rig.distances and part.views == 1 and part.sensor.enabled for part in parts)
    assert all(part.layout.container_share and part.lighting.tint for part in parts)


@pytest.mark.parametrize("name", [name for name in names_without_meshes() if name != "desk"])
def test_sizes_are_as_promised(name: str):
    recipe = load_recipe(name)
    assert (recipe.frames, recipe.views) == ((10, 1) if name in VIDEO else (1, 3))
    assert recipe.resolution == ((320, 240) if name in ("clevr3d", "multishape") else (128, 128))
    fewest_and_most = {"cluttered": (6, 8), "clevr3d": (3, 6)}.get(name, (2, 4))
    assert (recipe.objects.minimum, recipe.objects.maximum) == fewest_and_most
    assert recipe.video == (name in VIDEO)
    assert recipe.sensor.enabled == (name == "noisy")
    assert set(recipe.objects.categories) <= set(catalog.CATEGORIES)


@pytest.mark.parametrize("name", MESHES)
def test_the_ycb_recipes_name_the_papers_19_objects(name: str):
    recipe = load_recipe(name)
    assert recipe.needs_meshes
    assert len(set(recipe.objects.categories)) == 19
    assert (recipe.frames, recipe.views) == ((10, 1) if name == "ycb-moving" else (1, 3))
    # camera_info.npy of the authors: 175.84 pixels of focal length at 128, 1.032 m from where it looks.
    assert (recipe.rig.field_of_view, recipe.rig.distance, recipe.rig.elevation) == (40, 1.0324, 55)


def test_the_front_camera_is_the_papers():
    rig = load_recipe("moving").rig
    assert (rig.field_of_view, rig.distance, rig.elevation, rig.jitter) == (40, 1.03, 55, 0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"colour": 1}, r"\(colour\) @ recipe"),
        ({"objects": {"number": 3}}, r"\(number\) @ recipe\.objects"),
        ({"motion": {"weights": {"jump": 1.0}}}, r"\(jump\) @ recipe\.motion\.weights"),
    ],
)
def test_unknown_keys_are_refused_by_name(data: dict, words: str):
    with pytest.raises(UsageError, match=words):
        recipe_from_dict(data)


def test_an_unknown_recipe_suggests_a_known_one():
    with pytest.raises(UsageError, match="did you mean 'moving'"):
        load_recipe("movin")


def test_impossible_recipes_cannot_be_made():
    with pytest.raises(UsageError, match="beyond a table"):
        Recipe(layout=Layout(table_size=0.3))


def test_scenes_of_mixed_follow_its_parts_in_turn():
    mixed = load_recipe("mixed")
    names = [mixed.for_scene(index).name for index in range(7)]
    assert names == ["moving", "touching", "same-colour", "two-colour", "textured", "moving", "touching"]
    assert mixed.for_scene(1) == load_recipe("touching")
    assert load_recipe("moving").for_scene(3) == load_recipe("moving")


def test_what_is_set_on_mixed_holds_for_its_parts():
    changed = dataclasses.replace(load_recipe("mixed"), frames=4, rig=Rig(distance=1.5))
    for index in range(5):
        part = changed.for_scene(index)
        assert (part.frames, part.rig.distance) == (4, 1.5)
        original = load_recipe(part.name)
        assert dataclasses.replace(part, frames=10, rig=original.rig) == original


def test_objects_that_are_set_on_mixed_hold_for_its_parts_and_leave_the_rest():
    mixed = load_recipe("mixed")
    changed = dataclasses.replace(mixed, objects=dataclasses.replace(mixed.objects, minimum=3, density=(500.0, 900.0)))
    touching = changed.for_scene(1)
    assert (touching.objects.minimum, touching.objects.density) == (3, (500.0, 900.0))
    assert touching.objects.size == load_recipe("touching").objects.size


def test_overrides_hold_for_parts_even_where_they_are_the_defaults():
    mixed = load_recipe("mixed")
    assert mixed.for_scene(1).appearance.one_hue_share == 0.5
    changed = dataclasses.replace(mixed, overrides=("appearance.one_hue_share",))
    assert changed.for_scene(1).appearance.one_hue_share == 0.0
    assert changed.for_scene(1).physics == load_recipe("touching").physics
