import dataclasses
import math

import pytest

from datagen.config import load_recipe, recipe_names
from datagen.recipe_rules import LIMITS, OPTIONAL_RANGES, constants, problems, span
from tests.paths import ROOT


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
        ({"frames": 10**9}, "frames is 1000000000, expected 1 to 10,000"),
        ({"views": 10**6}, "views is 1000000, expected 1 to 360"),
        ({"views": 10**500}, "expected 1 to 360"),
        ({"fps": 1e9}, "fps is 1000000000.0, expected 0.001 to 1000 frames a second"),
        ({"attempts": 10**9}, "attempts is 1000000000, expected 1 to 10,000"),
        ({"frames": 10_000, "physics": {"step": 1e-5}, "fps": 30.0}, "take 33,336,666 steps a scene"),
        (
            {"physics": {"step": 1e-5, "settle_seconds": 60.0}},
            "take 6,075,486 steps a scene, expected at most",
        ),
        ({"sensor": {"grazing_angle": 120.0}}, "sensor.grazing_angle is 120.0, expected 0 to 90 degrees"),
        ({"sensor": {"axial_noise": 0.5}}, "sensor.axial_noise is 0.5, expected 0 to 0.1 metres"),
        ({"sensor": {"quantisation": 1.0}}, "sensor.quantisation is 1.0, expected 0 to 0.1 metres"),
        ({"rig": {"distance": 1e-9}}, "rig.distance is 1e-09, expected 0.05 to 100 metres"),
        ({"rig": {"elevation": -20.0}}, "put the cameras at a height of -35.2 cm above the table's top, expected more"),
        ({"rig": {"elevation": 0.0}}, "put the cameras at a height of 0.0 cm above"),
        ({"rig": {"target": (0.0, 0.0, -1.0)}}, "put the cameras at a height of -15.6 cm above"),
        ({"motion": {"weights": {"rest": 1e308, "drop": 1e308}}}, "motion.weights.rest is 1e+308"),
        ({"motion": {"push_duration": (1e-300, 1.0)}}, "motion.push_duration"),
        ({"motion": {"push_duration": (0.001, 1.0)}}, "below physics.step"),
        ({"lighting": {"key": (1e308, 1e308)}}, "lighting.key"),
        (
            {"objects": {"categories": ("cube", "cubes")}},
            "objects.categories has unknown cubes, expected some of",
        ),
        ({"appearance": {"finishes": ()}}, "appearance.finishes names none"),
        ({"least_visible_pixels": 20_000}, "a frame of visibility_resolution has only 16384 pixels"),
    ],
)
def test_impossible_settings_are_named(change: dict, words: str):
    recipe = dataclasses.asdict(load_recipe("moving"))
    assert words in "; ".join(problems(merged(recipe, change)))


def merged(values: dict, changes: dict) -> dict:
    return {**values, **{k: merged(values[k], v) if isinstance(v, dict) else v for k, v in changes.items()}}


def numbers(recipe: dict) -> dict[str, object]:
    """Every constant of a recipe that is a number, or holds numbers."""
    found = {}
    for name, value in constants(recipe):
        parts = value if isinstance(value, tuple) else (value,)
        if name == "objects.sizes" or (parts and all(type(part) in (int, float) for part in parts)):
            found[name] = value
    return found


def with_constant(name: str, value: object) -> dict:
    """`moving` with another value of a constant."""
    recipe = dataclasses.asdict(load_recipe("moving"))
    part, (*path, leaf) = recipe, name.split(".")
    for key in path:
        part = part[key]
    part[leaf] = value
    return recipe


def test_every_number_has_limits_and_no_others_have():
    assert set(LIMITS) - set(OPTIONAL_RANGES) == set(numbers(dataclasses.asdict(load_recipe("moving"))))
    assert set(OPTIONAL_RANGES) <= set(LIMITS)


@pytest.mark.parametrize("name", sorted(OPTIONAL_RANGES))
def test_ranges_have_two_numbers_in_order_or_none(name: str):
    low, high, _ = LIMITS[name]
    least, most = max(low, 3.0), min(high, 5.0)
    assert list(problems(with_constant(name, (least, most)))) == []
    assert "expected the least before the greatest" in "; ".join(problems(with_constant(name, (most, least))))
    assert "has 1 numbers, expected a least and a greatest one" in "; ".join(problems(with_constant(name, (least,))))
    assert f"{name} is" in "; ".join(problems(with_constant(name, (low - 1, high))))


@pytest.mark.parametrize("name", sorted(set(LIMITS) - set(OPTIONAL_RANGES)))
def test_numbers_beyond_their_limits_are_refused_by_name(name: str):
    default = numbers(dataclasses.asdict(load_recipe("moving")))[name]
    length = len(default) or 1 if isinstance(default, tuple) else 0
    low, high, _ = LIMITS[name]
    for value in (low - 1, high + 1, -(10**30), 10**30):
        if math.isfinite(high) or value < low:
            given = (value,) * length if length else value
            assert f"{name} is {given}, expected " in "; ".join(problems(with_constant(name, given)))
    for value in (low, high if math.isfinite(high) else low):
        given = (value,) * length if length else value
        assert f"{name} is {given}, expected" not in "; ".join(problems(with_constant(name, given)))


def test_a_low_camera_that_looks_up_from_above_the_table_is_possible():
    recipe = dataclasses.asdict(load_recipe("moving"))
    recipe["rig"] |= {"elevation": -5.0, "distance": 1.0, "target": (0.0, 0.0, 0.2)}
    assert list(problems(recipe)) == []


def test_the_documentation_states_every_limit():
    text = (ROOT / "docs" / "dataset.md").read_text()
    for name, (low, high, unit) in LIMITS.items():
        assert f"| `{name}` | {span(low, high)} | {unit or '-'} |" in text
