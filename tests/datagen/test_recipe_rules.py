import dataclasses

import pytest

from datagen.config import load_recipe, recipe_names
from datagen.recipe_rules import problems


@pytest.mark.parametrize("name", recipe_names())
def test_every_recipe_that_ships_is_possible(name: str):
    assert list(problems(dataclasses.asdict(load_recipe(name)))) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"frames": 0}, "frames is 0"),
        ({"fps": -1.0}, "fps"),
        ({"resolution": (0, 64)}, "resolution"),
        ({"objects": {"minimum": 5}}, "minimum 5 exceeds objects.maximum 4"),
        ({"objects": {"maximum": 300}}, "at most 250"),
        ({"objects": {"size": (0.2, 0.1)}}, "least before the greatest"),
        ({"objects": {"sizes": (0.1, 0.0)}}, "objects.sizes"),
        ({"layout": {"table_size": 0.5}}, "beyond a table"),
        ({"layout": {"placement": "touching"}, "objects": {"minimum": 1}}, "at least 2"),
        ({"appearance": {"metal_share": 1.5}}, "appearance.metal_share is 1.5, expected 0 to 1"),
        ({"motion": {"weights": dict.fromkeys(("rest", "drop", "slide", "roll", "push", "throw"), 0.0)}}, "all 0"),
        ({"rig": {"elevation": 90.0}}, "rig.elevation"),
        ({"rig": {"field_of_view": 180.0}}, "rig.field_of_view"),
        ({"physics": {"step": 0.0}}, "physics.step"),
    ],
)
def test_impossible_settings_are_named(change: dict, words: str):
    recipe = dataclasses.asdict(load_recipe("moving"))
    for name, value in change.items():
        recipe[name] = {**recipe[name], **value} if isinstance(value, dict) else value
    assert words in "; ".join(problems(recipe))
