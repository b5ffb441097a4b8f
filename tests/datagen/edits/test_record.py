import dataclasses

import numpy as np
import pytest

from datagen import schema
from datagen.render import make_renderer
from datagen.render.renderer import render_clip, stack_images
from datagen.schema import EDITS, effect_mask
from datagen.shapes import build
from tests.worlds import rendered

WORLD = rendered.scene(views=2)
RECORD = rendered.record(WORLD, edits=EDITS)
IMAGES = ("rgb", "depth", "segmentation")


def test_an_edited_record_is_valid_and_its_other_arrays_are_as_without_edits():
    schema.validate(RECORD, (*rendered.GROUPS, *EDITS))
    for name, array in rendered.record(WORLD).items():
        np.testing.assert_array_equal(RECORD[name], array, err_msg=name)


def test_one_edit_is_the_same_with_and_without_the_others():
    alone = rendered.record(WORLD, edits=["remove"])
    for name in alone:
        np.testing.assert_array_equal(alone[name], RECORD[name], err_msg=name)


def test_a_removal_is_the_render_of_a_scene_without_the_object_bit_for_bit():
    name = int(RECORD["edits/remove/object"])
    left = [row for row in range(3) if row != name - 1]
    world = dataclasses.replace(WORLD, bodies=tuple(WORLD.bodies[row] for row in left))
    poses = rendered.trajectory(WORLD).world_from_object[:, left]
    images = render_clip(world, [build(body.shape) for body in world.bodies], poses, make_renderer("raster"), (64, 64))
    np.testing.assert_array_equal(RECORD["edits/remove/rgb"], stack_images(images, "rgb"))
    ids = np.array([0, left[0] + 1, left[1] + 1])[stack_images(images, "segmentation")]
    np.testing.assert_array_equal(RECORD["edits/remove/segmentation"], ids)


def test_the_others_keep_their_pixels_and_the_copy_has_the_next_id():
    removed, before = RECORD["edits/remove/segmentation"], RECORD["segmentation"]
    name = int(RECORD["edits/remove/object"])
    assert not np.any(removed == name)
    np.testing.assert_array_equal(removed[before != name], before[before != name])
    copied = RECORD["edits/add/segmentation"]
    assert set(np.unique(copied)) == {0, 1, 2, 3, 4}
    np.testing.assert_array_equal(copied[copied != 4], before[copied != 4])


def test_effects_are_the_shadow_the_object_casts_and_not_the_object():
    name, effects = int(RECORD["edits/remove/object"]), RECORD["edits/remove/effects"]
    shadow = effect_mask(effects, name)
    lighter = RECORD["edits/remove/rgb"].astype(int).sum(-1) - RECORD["rgb"].astype(int).sum(-1)
    assert 50 < np.sum(shadow) < 0.2 * shadow.size
    assert np.all(lighter[shadow] >= schema.LEAST_EFFECT)
    assert not np.any(shadow & (RECORD["segmentation"] == name))


def test_without_shadows_there_are_no_effects():
    light = dataclasses.replace(WORLD.lights[0], casts_shadow=False)
    record = rendered.record(dataclasses.replace(WORLD, lights=(light,)), edits=["remove"])
    assert not np.any(record["edits/remove/effects"])
    assert np.any(record["edits/remove/rgb"] != record["rgb"])


def test_without_its_only_object_the_table_is_empty():
    record = rendered.record(rendered.scene(rendered.STANDING[:1]), edits=["remove"])
    assert record["edits/remove/object"] == 1
    assert not np.any(record["edits/remove/segmentation"])


@pytest.mark.parametrize("kind", ["move", "add"])
def test_where_nothing_can_be_edited_the_images_are_the_scene_s_own(kind: schema.EditKind):
    flying = rendered.scene([(rendered.SPHERE, (0.28, 0.0, 0.2))])
    record = rendered.record(flying, edits=[kind])
    assert record[f"edits/{kind}/object"] == 0
    for name in IMAGES:
        np.testing.assert_array_equal(record[f"edits/{kind}/{name}"], record[name])
