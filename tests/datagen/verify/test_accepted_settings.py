"""Property: settings within the documented bounds are refused, or give scenes in which `verify` finds nothing."""

import copy
import dataclasses
import importlib.util
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from datagen.config import load_recipe, recipe_from_dict, recipe_to_dict
from datagen.errors import UsageError
from datagen.pipeline.generate import Run, generate, render
from datagen.pipeline.make_scene import make_scene, renderer_identity
from datagen.recipe_rules import LIMITS, OPTIONAL_RANGES, RANGES
from datagen.render import make_renderer
from datagen.schema import EDITS, SIGNALS, SceneRecord
from datagen.storage.spec import Spec, groups_of, make_spec, recipe_of
from datagen.verify import Finding, verify_record
from datagen.verify.dataset import find

pytestmark = pytest.mark.skipif(not importlib.util.find_spec("pybullet"), reason="simulation needs PyBullet")

RECIPES = [dataclasses.asdict(load_recipe(name)) for name in ("moving", "touching", "cluttered", "noisy")]
STILLS = [dataclasses.asdict(load_recipe(name)) for name in ("static", "clevr3d", "multishape")]

SMALLER = {
    "frames": (1, 4),
    "fps": (1, 1000),
    "views": (1, 5),
    "visibility_resolution": (8, 64),
    "least_visible_pixels": (0, 30),
    "attempts": (2, 8),
    "objects.minimum": (1, 4),
    "objects.maximum": (3, 6),
    "objects.size": (0.01, 1),
    "objects.sizes": (0.01, 1),
    "layout.tries": (1, 60),
    "layout.center": (-1, 1),
    "layout.half_extent": (0.001, 2),
    "layout.gap": (0, 0.2),
    "layout.workspace_half_extent": (0.1, 3),
    "layout.table_size": (0.5, 10),
    "motion.speed": (0, 5),
    "motion.least_travel": (0, 0.1),
    "motion.drop_height": (0, 1),
    "rig.distance": (0.05, 3),
    "rig.elevation": (-20, 89.9),
    "rig.target": (-0.5, 0.5),
    "rig.jitter": (0, 0.2),
    "rig.travel": (-1, 1),
    "rig.shake": (0, 0.2),
    "physics.step": (1 / 2000, 1 / 120),
    "physics.settle_seconds": (0, 0.5),
}
"""Narrower bounds where the whole range would take too long, or would hardly ever give a scene."""

CHOICES = {
    "layout.placement": ["scattered", "touching", "stacked"],
    "appearance.style": ["varied", "same-colour", "two-colour", "textured"],
    "motion.moving": [True, False],
    "lighting.shadows": [True, False],
    "sensor.enabled": [True, False],
}

FIXED = settings(phases=[Phase.generate], suppress_health_check=[HealthCheck.too_slow])
"""Equal examples in every run; a failing one is printed as it is, since shrinking would take minutes."""


@st.composite
def constants(draw: st.DrawFn, name: str, like: Any) -> Any:
    """A value of the same kind as `like` within the bounds of a constant; the bounds themselves are drawn often."""
    if isinstance(like, tuple):
        values = tuple(draw(constants(name, part)) for part in like or (0.1,))
        return tuple(sorted(values)) if name in RANGES else values
    low, high = SMALLER.get(OPTIONAL_RANGES.get(name, name), LIMITS[name][:2])
    if isinstance(like, int):
        return draw(st.integers(int(low), int(high)))
    inside = st.floats(low, high) if low <= 0 else st.floats(np.log(low), np.log(high)).map(lambda x: float(np.exp(x)))
    return float(min(max(draw(st.one_of(st.sampled_from([low, high]), inside, inside)), low), high))


@st.composite
def requests(draw: st.DrawFn, edits: tuple[str, ...] = EDITS) -> dict[str, Any]:
    """Plain values of a recipe in which up to five constants are changed, and the other settings of a dataset."""
    values = copy.deepcopy(draw(st.sampled_from(RECIPES + STILLS)))
    values |= {"frames": min(values["frames"], 3), "attempts": 6}
    names = sorted({*LIMITS, *CHOICES} - {"resolution"})
    for name in draw(st.lists(st.sampled_from(names), max_size=5, unique=True)):
        part, (*path, leaf) = values, name.split(".")
        for key in path:
            part = part[key]
        if name in LIMITS:
            part[leaf] = draw(constants(name, (0.0, 0.0) if name in OPTIONAL_RANGES else part[leaf]))
        else:
            part[leaf] = draw(st.sampled_from(CHOICES[name]))
    rig = {"rig": values["rig"], "views": values["views"]} if draw(st.booleans()) else None
    return {
        "values": values,
        "seed": draw(st.integers(0, 99)),
        "resolution": (draw(st.integers(8, 48)), draw(st.integers(8, 48))),
        "rig": rig,
        "edits": draw(st.sampled_from([(), (), (), edits])),
    }


def findings(
    values: dict[str, Any], *, renderer: str = "raster", scenes: int = 1, **other: Any
) -> list[Finding] | None:
    """Findings of `verify` in the first scenes of a dataset; None where the generator refuses the settings."""
    try:
        recipe = recipe_to_dict(recipe_from_dict(values))
        spec = make_spec(recipe, splits={"test": scenes}, renderer=renderer_identity(renderer), **other)
        records = [make_scene(spec, "test", index) for index in range(scenes)]
    except UsageError:
        return None
    return [finding for index, record in enumerate(records) for finding in findings_of(spec, index, record)]


def findings_of(spec: Spec, index: int, record: SceneRecord) -> list[Finding]:
    """Findings of `verify` in one scene."""
    recipe, renderer = recipe_of(spec), spec["renderer"]["name"]
    physics = recipe.for_scene(index).physics
    return verify_record(record, groups_of(spec), physics, sensor=recipe.sensor, renderer=renderer)


def check(
    drawn: st.SearchStrategy[dict[str, Any]],
    run: Callable[..., list[Finding] | None] = findings,
    *,
    examples: int,
    least: int,
    **options: Any,
) -> None:
    """Assert that no accepted example gives a finding, and that the generator accepts at least so many of them."""
    accepted = 0

    @settings(FIXED, max_examples=examples)
    @given(drawn)
    def example(request: dict[str, Any]) -> None:
        nonlocal accepted
        found = run(**request, **options)
        accepted += found is not None
        assert not found

    example()
    assert accepted >= least


def test_what_is_accepted_is_verified():
    check(requests(edits=("remove",)), examples=15, least=7)


@pytest.mark.slow
def test_much_of_what_is_accepted_is_verified():
    check(requests(), examples=150, least=75, scenes=2)


@pytest.mark.slow
def test_datasets_that_are_made_and_rendered_again_are_verified():
    check(requests(edits=()), findings_when_rendered_again, examples=20, least=10)


def findings_when_rendered_again(values: dict[str, Any], seed: int, resolution: tuple[int, int], **_: Any) -> Any:
    """Findings in a dataset, and in one that is rendered from it; None where either is refused."""
    common = {"resolution": resolution, "run": Run(splits=("test",))}
    with tempfile.TemporaryDirectory() as folder:
        made, again = Path(folder, "made"), Path(folder, "again")
        try:
            recipe = recipe_from_dict(values)
            generate(made, recipe, splits={"test": 2}, seed=seed, **common)
            render(made, again, rig=recipe, **common)
        except UsageError:
            return None
        return find(made) + find(again)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_what_the_other_renderer_accepts_is_verified():
    try:
        make_renderer("pyrender")
    except UsageError as error:
        pytest.skip(str(error))
    check(requests(edits=()), examples=40, least=20, renderer="pyrender")


@st.composite
def views(draw: st.DrawFn) -> dict[str, Any]:
    """Settings of cameras over the whole range, for objects that need not be seen."""
    recipe = draw(st.sampled_from(STILLS))
    single = {f"rig.{name}" for name in recipe["rig"]} & LIMITS.keys() - OPTIONAL_RANGES.keys()
    drawn = {name.removeprefix("rig."): name for name in sorted(single)}
    rig = recipe["rig"] | {key: draw(constants(name, recipe["rig"][key])) for key, name in drawn.items()}
    rig["field_of_view"] = draw(st.floats(1, 170))
    width, height = draw(st.sampled_from([(8, 8), (16, 16), (64, 64), (9, 40), (40, 9), (128, 32)]))
    changes = {"least_visible_pixels": 0, "views": draw(st.sampled_from([1, 2, 5, 24])), "rig": rig, "attempts": 6}
    return {"values": {**recipe, **changes}, "resolution": (width, height), "seed": draw(st.integers(0, 99))}


@pytest.mark.slow
def test_every_accepted_camera_is_verified():
    check(views(), examples=20, least=5)


@st.composite
def camera_paths(draw: st.DrawFn) -> dict[str, Any]:
    """Settings of cameras that move, with all signals that fit."""
    recipe = copy.deepcopy(draw(st.sampled_from(RECIPES)))
    recipe["rig"]["motion"] = draw(st.sampled_from(["orbit", "linear", "handheld"]))
    for name in ("orbit", "travel", "shake", "sway"):
        recipe["rig"][name] = draw(constants(f"rig.{name}", recipe["rig"][name]))
    recipe |= {"frames": draw(st.integers(1, 4)), "views": draw(st.integers(1, 3)), "attempts": 6}
    recipe["least_visible_pixels"] = draw(st.sampled_from([0, recipe["least_visible_pixels"]]))
    return {
        "values": recipe,
        "resolution": (draw(st.integers(8, 48)), draw(st.integers(8, 48))),
        "seed": draw(st.integers(0, 99)),
        "signals": draw(st.sampled_from([(), SIGNALS])),
    }


@pytest.mark.slow
def test_every_accepted_camera_path_is_verified():
    check(camera_paths(), examples=40, least=20)
