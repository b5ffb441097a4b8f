import dataclasses

import numpy as np
import pytest

from datagen import shapes
from datagen.catalog import TABLETOP
from datagen.config import Objects, load_recipe
from datagen.sampling.items import sample_item, sample_items


def test_counts_cover_the_recipes_range():
    rng = np.random.default_rng(0)
    assert {len(sample_items(Objects(categories=("box",)), "train", rng)) for _ in range(40)} == {2, 3, 4}


def test_objects_have_the_sizes_of_the_recipe():
    rng = np.random.default_rng(0)
    lengths = [np.max(sample_item(Objects(), "train", rng).shape.size) for _ in range(40)]
    assert min(lengths) >= 0.03 - 1e-4
    assert max(lengths) <= 0.16 + 1e-4
    assert np.std(lengths) > 0.02


def test_two_sizes_are_two_sizes():
    rng = np.random.default_rng(0)
    objects = load_recipe("clevr3d").objects
    lengths = {round(float(np.max(sample_item(objects, "train", rng).shape.size)), 3) for _ in range(30)}
    assert lengths == {0.07, 0.14}


def test_no_categories_means_all_that_lie_on_tables():
    rng = np.random.default_rng(0)
    found = {sample_item(Objects(), "train", rng).category for _ in range(80)}
    assert found <= set(TABLETOP)
    assert len(found) > 0.7 * len(TABLETOP)


def test_the_test_split_has_shapes_of_its_own():
    rng = np.random.default_rng(0)
    objects = dataclasses.replace(load_recipe("multishape").objects, shape_pool=5, categories=("stool", "bench"))
    found = {split: {} for split in ("train", "val", "test")}
    for split, members in found.items():
        for _ in range(50):
            item = sample_item(objects, split, rng)
            assert members.setdefault((item.category, item.shape_id), item.spec) == item.spec
    shared = found["train"].keys() & found["val"].keys()
    assert all(found["train"][member] == found["val"][member] for member in shared)
    assert {number for _, number in found["train"]} == {0, 1, 2, 3, 4}
    assert {number for _, number in found["test"]} == {5, 6, 7, 8, 9}
    texts = [{repr(spec) for spec in found[split].values()} for split in ("train", "test")]
    assert not texts[0] & texts[1]


def test_an_items_shape_is_its_specs():
    item = sample_item(Objects(), "train", np.random.default_rng(0))
    assert item.shape_id is None
    np.testing.assert_array_equal(item.shape.vertices, shapes.build(item.spec).vertices)


@pytest.mark.parametrize("name", ["density", "friction", "restitution"])
def test_mechanical_properties_stay_within_their_ranges(name: str):
    rng = np.random.default_rng(0)
    objects = Objects(categories=("box",))
    low, high = getattr(objects, name)
    values = [getattr(sample_item(objects, "train", rng), name) for _ in range(50)]
    assert low <= min(values) < max(values) <= high
