import dataclasses

import numpy as np
import pytest

from datagen.catalog import CONTAINERS
from datagen.config import load_recipe, names_without_meshes
from datagen.sampling import Rejected, sample_scene
from datagen.scene import Scene, scene_from_json, scene_to_json


def scene(name: str, seed: int = 0, index: int = 0, split: str = "train") -> Scene:
    rng = np.random.default_rng(seed)
    for _ in range(100):
        try:
            return sample_scene(load_recipe(name), rng, split, index)
        except Rejected:
            continue
    raise AssertionError(name)


@pytest.mark.parametrize("name", names_without_meshes())
def test_scenes_survive_the_way_through_json_and_follow_their_generator(name: str):
    made = scene(name)
    assert scene_from_json(scene_to_json(made)) == made
    assert scene(name) == made
    assert scene(name, seed=1) != made


@pytest.mark.parametrize("name", names_without_meshes())
def test_a_scenes_text_is_short(name: str):
    made = scene(name)
    assert len(scene_to_json(made)) < 700 + 700 * len(made.bodies) + 100 * len(made.cameras)


def test_recipes_that_differ_in_looks_only_share_their_motion():
    moving, textured = scene("moving", seed=4), scene("textured", seed=4)
    plain = [dataclasses.replace(body, material=moving.bodies[0].material) for body in moving.bodies]
    assert plain == [dataclasses.replace(body, material=plain[0].material) for body in textured.bodies]
    assert moving.cameras == textured.cameras


def test_mixed_draws_what_its_part_draws():
    for index, name in enumerate(load_recipe("mixed").parts):
        assert scene("mixed", index=index) == scene(name, index=index)


def test_a_container_replaces_an_object():
    recipe = load_recipe("cluttered")
    recipe = dataclasses.replace(recipe, layout=dataclasses.replace(recipe.layout, container_share=1.0))
    for seed in range(5):
        bodies = sample_scene(recipe, np.random.default_rng(seed), "train", 0).bodies
        assert bodies[0].category in CONTAINERS
        assert recipe.objects.minimum <= len(bodies) <= recipe.objects.maximum


def test_touching_scenes_hold_a_group_of_one_friction_and_velocity():
    for seed in range(10):
        made = scene("touching", seed=seed)
        together = [body for body in made.bodies if body.friction == made.bodies[0].friction]
        assert len(together) >= 2
        assert len({body.linear_velocity for body in together}) == 1
