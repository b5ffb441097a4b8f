import numpy as np

from datagen.edits.edit_context import stage_of
from datagen.edits.record import changed, packed, touched
from datagen.render import make_renderer
from datagen.schema import LEAST_EFFECT
from datagen.shapes import build
from tests.worlds import rendered


def test_a_change_is_counted_over_the_channels_and_either_way():
    rgb = np.full((1, 1, 1, 3, 3), 100, np.uint8)
    other = rgb.copy()
    other[..., 0, :] += LEAST_EFFECT // 3
    other[..., 1, :] -= LEAST_EFFECT // 3
    other[..., 2, :] += LEAST_EFFECT // 3 - 1
    assert changed(rgb, other).ravel().tolist() == [True, True, False]


def test_nine_objects_take_two_bytes_and_none_takes_one():
    masks = [np.full((1, 1, 2, 2), row == 8) for row in range(9)]
    assert packed(masks, (1, 1, 2, 2))[0, 0, 0, 0].tolist() == [0, 1]
    assert packed([], (1, 1, 2, 2)).shape == (1, 1, 2, 2, 1)


def test_an_object_touches_all_pixels_that_carry_its_id_and_their_rim():
    world = rendered.scene()
    record = rendered.record(world)
    stage = stage_of(world, tuple(build(body.shape) for body in world.bodies), rendered.trajectory(world))
    for name, mask in touched(stage, record, make_renderer("raster")).items():
        own = record["segmentation"] == name
        assert np.all(mask[own])
        assert 0 < np.sum(mask & ~own) < np.sum(own)
