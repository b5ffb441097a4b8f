import dataclasses
import math

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
        ({"physics": {"step": 10.0}}, "physics.step is 10.0, expected 1e-05 to 0.00833333 seconds"),
        ({"physics": {"gravity": 0.0}}, "physics.gravity is 0.0, expected 0.1 to 100 m/s^2"),
        ({"physics": {"settle_seconds": math.inf}}, "physics.settle_seconds is inf, expected finite"),
        ({"physics": {"deepest_overlap": 0.01}}, "physics.deepest_overlap"),
        ({"fps": math.inf}, "fps is inf, expected finite"),
        ({"fps": 0.001}, "fps 0.001 takes 480000 steps"),
        ({"rig": {"target": (0.0, 0.0, math.nan)}}, "rig.target"),
        ({"appearance": {"palette": ("red",)}}, "appearance.palette is ('red',), expected colours such as #ad2323"),
        ({"appearance": {"palette": ("#zzzzzz",)}}, "appearance.palette"),
        ({"appearance": {"palette": ("",)}}, "appearance.palette"),
        ({"appearance": {"table_color": "blue"}}, "appearance.table_color"),
        ({"objects": {"size": (0.00001, 0.00002)}}, "objects.size is (1e-05, 2e-05), expected 0.01 to 10 metres"),
        ({"objects": {"density": (1e-20, 1e30)}}, "objects.density"),
        ({"objects": {"restitution": (0.5, 1.5)}}, "objects.restitution"),
        ({"lighting": {"elevation": (-90.0, -80.0)}}, "lighting.elevation"),
        ({"lighting": {"elevation": (70.0, 60.0)}}, "least before the greatest"),
        ({"lighting": {"softness": 1000.0}}, "lighting.softness"),
        ({"overrides": ("rig.color",)}, "overrides names rig.color"),
    ],
)
def test_impossible_settings_are_named(change: dict, words: str):
    recipe = dataclasses.asdict(load_recipe("moving"))
    for name, value in change.items():
        recipe[name] = {**recipe[name], **value} if isinstance(value, dict) else value
    assert words in "; ".join(problems(recipe))
