import dataclasses

import numpy as np
import pytest

from datagen.config import Layout, Recipe
from datagen.edits.choice import choose_edit
from datagen.edits.edit_context import Stage, stage_of
from datagen.render.visible_range import near_object, visible_pixels
from datagen.sampling.poses import Stance
from datagen.scene import Camera
from datagen.schema import EditKind
from datagen.shapes import build
from tests.worlds import rendered


def stage(world=None) -> Stage:
    world = world or rendered.scene(views=2)
    return stage_of(world, tuple(build(body.shape) for body in world.bodies), rendered.trajectory(world))


STAGE = stage()


def choose(kind: EditKind, seed: int = 0, recipe: Recipe = rendered.RECIPE, scene: Stage = STAGE):
    return choose_edit(kind, recipe, scene, np.random.default_rng(seed))


def test_every_object_is_removed_as_often():
    rows = [choose("remove", seed).row for seed in range(60)]
    assert all(10 < rows.count(row) < 30 for row in range(3))


@pytest.mark.parametrize("kind", ["move", "add"])
@pytest.mark.parametrize("seed", range(4))
def test_a_new_place_is_free_in_view_and_on_the_table_in_all_frames(kind: EditKind, seed: int):
    edit, layout = choose(kind, seed), rendered.RECIPE.layout
    assert edit.row is not None
    new = edit.transform @ STAGE.world_from_object[:, edit.row]
    np.testing.assert_allclose(new[:, 2, 3], STAGE.world_from_object[:, edit.row, 2, 3])
    assert np.all(np.abs(new[0, :2, 3] - layout.center) <= np.array(layout.half_extent) + 1e-9)
    reach = [Stance(shape, np.eye(3)).reach for shape in STAGE.shapes]
    for frame, other in np.ndindex(3, 3):
        distance = np.linalg.norm(new[frame, :2, 3] - STAGE.world_from_object[frame, other, :2, 3])
        assert distance > reach[edit.row] + reach[other] + layout.gap - 1e-9
    seen = visible_pixels(rendered.RECIPE, edit.stage.scene, edit.stage.shapes, edit.stage.world_from_object[0])
    assert np.min(seen) >= rendered.RECIPE.least_visible_pixels


def test_what_is_moved_is_not_turned_and_a_copy_is():
    np.testing.assert_array_equal(choose("move").transform[:3, :3], np.eye(3))
    assert choose("add").transform[0, 0] < 0.99


def test_where_there_is_no_place_nothing_is_edited():
    crowded = dataclasses.replace(
        rendered.RECIPE, layout=Layout(center=(0.28, 0.0), half_extent=(0.01, 0.01), tries=20)
    )
    edit = choose("move", recipe=crowded)
    assert edit.row is None
    assert edit.stage is STAGE
    np.testing.assert_array_equal(edit.transform, np.eye(4))


def test_what_never_comes_near_the_table_is_not_moved():
    flying = stage(rendered.scene([(rendered.SPHERE, (0.28, 0.0, 0.2))]))
    assert choose("move", scene=flying).row is None
    assert choose("remove", scene=flying).row == 0


def test_nothing_is_moved_to_where_a_camera_would_cut_it():
    low = Camera((0.0, 0.0, 0.1), (0.3, 0.0, 0.05), float(np.radians(60)))
    near = stage(dataclasses.replace(rendered.scene(), cameras=(low,)))
    wide = dataclasses.replace(
        rendered.RECIPE, layout=Layout(center=(0.1, 0.0), half_extent=(0.2, 0.2), tries=200), least_visible_pixels=0
    )
    edits = [choose("move", seed, wide, near) for seed in range(12)]
    assert all(near_object(low, edit.stage.shapes, edit.stage.world_from_object, 128, 128) is None for edit in edits)
    assert any(edit.row is not None for edit in edits)
