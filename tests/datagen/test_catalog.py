import json

import numpy as np
import pytest

from datagen.catalog import CATEGORIES, TABLETOP, sample_shape
from datagen.errors import UsageError
from datagen.scene import ShapeSpec
from datagen.shapes import FAMILIES, build

SIZE = (0.04, 0.15)
FURNITURE = [name for name, category in CATEGORIES.items() if category.group == "furniture"]


@pytest.mark.parametrize("category", CATEGORIES)
def test_longest_sides_lie_within_the_asked_bounds(category):
    rng = np.random.default_rng(5)
    longest = [build(sample_shape(category, rng, (0.03, 0.05))).size.max() for _ in range(8)]
    assert min(longest) >= 0.03
    assert max(longest) <= 0.05


@pytest.mark.parametrize("category", CATEGORIES)
def test_specs_survive_json_and_build_the_same_arrays(category):
    spec = sample_shape(category, np.random.default_rng(2), SIZE)
    again = ShapeSpec(spec.family, json.loads(json.dumps(spec.parameters)))
    assert again == spec
    first = build(spec)
    for other in range(40):
        build(ShapeSpec("sphere", {"radius": 0.01 + 0.0001 * other}))
    second = build(again)
    assert second is not first
    for name in ("vertices", "faces", "normals", "inertia"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


@pytest.mark.parametrize("category", CATEGORIES)
def test_members_differ(category):
    rng = np.random.default_rng(2)
    assert sample_shape(category, rng, SIZE) != sample_shape(category, rng, SIZE)


@pytest.mark.parametrize("category", FURNITURE)
def test_furniture_stands_on_feet_around_its_middle(category):
    vertices = build(sample_shape(category, np.random.default_rng(2), SIZE)).vertices
    feet = vertices[vertices[:, 2] < vertices[:, 2].min() + 1e-6, :2]
    assert (feet.min(0) < 0).all()
    assert (feet.max(0) > 0).all()


def test_every_category_belongs_to_one_group_and_every_family_has_a_category():
    named = {"can", "crate"}
    assert {*TABLETOP} | {*FURNITURE} | named == set(CATEGORIES)
    assert not {*TABLETOP} & {*FURNITURE}
    assert not named & {*TABLETOP, *FURNITURE}
    assert {category.family for category in CATEGORIES.values()} == set(FAMILIES)


def test_unknown_names_and_sizes_are_refused():
    with pytest.raises(UsageError, match="Unknown category 'spehre'"):
        sample_shape("spehre", np.random.default_rng(0), SIZE)
    with pytest.raises(UsageError, match="size"):
        sample_shape("sphere", np.random.default_rng(0), (0.2, 0.1))
    with pytest.raises(UsageError, match="Unknown shape family"):
        build(ShapeSpec("spehre", {}))
    with pytest.raises(UsageError, match="cannot be built"):
        build(ShapeSpec("sphere", {"diameter": 0.1}))
    mug = {"radius": 0.04, "height": 0.09, "wall": 0.001, "floor": 0.005}
    handle = {"handle_height": 0.06, "handle_reach": 0.03, "handle_thickness": 0.006, "handle_width": 0.03}
    with pytest.raises(UsageError, match="wall"):
        build(ShapeSpec("mug", mug | handle))


@pytest.mark.parametrize(
    ("family", "parameters"),
    [
        ("sphere", {"radius": "wide"}),
        ("sphere", {"radius": []}),
        ("sphere", {"radius": float("nan")}),
        ("box", {"size": [0.1]}),
        ("prism", {"corners": 0, "radius": 0.1, "height": 0.1}),
        ("gear", {"teeth": -1, "outer_radius": 0.1, "inner_radius": 0.05, "tooth_share": 0.5, "height": 0.1}),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_parameters_that_make_no_shape_are_refused(family: str, parameters: dict[str, object]):
    with pytest.raises(UsageError, match=f"Shape family '{family}' cannot be built from"):
        build(ShapeSpec(family, parameters))
