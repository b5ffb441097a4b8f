import numpy as np

from datagen.edits.edit_context import displaced, stage_of, with_copy, without
from datagen.geometry import transform
from datagen.shapes import build
from tests.worlds import rendered

WORLD = rendered.scene()
STAGE = stage_of(WORLD, tuple(build(body.shape) for body in WORLD.bodies), rendered.trajectory(WORLD))
TURN = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def test_without_an_object_the_others_keep_their_ids():
    left = without(STAGE, 1)
    assert left.ids == (1, 3)
    assert [body.shape for body in left.scene.bodies] == [rendered.BOX, rendered.SPHERE]
    np.testing.assert_array_equal(left.world_from_object, STAGE.world_from_object[:, [0, 2]])
    np.testing.assert_array_equal(left.named(np.array([[0, 1, 2]], np.uint8)), [[0, 1, 3]])


def test_a_displaced_object_is_carried_along_in_all_frames_and_nothing_else_is():
    moved = displaced(STAGE, 1, TURN)
    corner = np.array([0.01, 0.02, 0.03])
    for old, new in zip(STAGE.world_from_object, moved.world_from_object, strict=True):
        np.testing.assert_allclose(transform(new[1], corner), transform(TURN, transform(old[1], corner)))
        np.testing.assert_array_equal(new[[0, 2]], old[[0, 2]])
    assert moved.ids == (1, 2, 3)


def test_a_copy_is_one_more_object_and_the_first_stays():
    more = with_copy(STAGE, 0, TURN)
    assert more.ids == (1, 2, 3, 4)
    assert more.scene.bodies[3] == more.scene.bodies[0]
    np.testing.assert_array_equal(more.world_from_object[:, :3], STAGE.world_from_object)
    np.testing.assert_array_equal(more.world_from_object[:, 3], TURN @ STAGE.world_from_object[:, 0])
