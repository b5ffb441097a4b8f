from pathlib import Path

import numpy as np
import pytest

from datagen.edits.edit_context import stage_of
from datagen.edits.record import changed, packed, touched
from datagen.render import make_renderer
from datagen.schema import LEAST_EFFECT, effect_mask
from datagen.shapes import build
from datagen.storage.reader import Dataset
from tests.worlds import rendered


def test_a_change_is_counted_over_the_channels_and_either_way():
    rgb = np.full((1, 1, 1, 3, 3), 100, np.uint8)
    other = rgb.copy()
    other[..., 0, :] += LEAST_EFFECT // 3
    other[..., 1, :] -= LEAST_EFFECT // 3
    other[..., 2, :] += LEAST_EFFECT // 3 - 1
    assert changed(rgb, other).ravel().tolist() == [True, True, False]


def test_bytes_are_as_many_as_the_rows_of_the_object_axis_need():
    masks = [np.full((1, 1, 2, 2), row in (0, 8)) for row in range(9)]
    assert packed(masks, (1, 1, 2, 2), 9)[0, 0, 0, 0].tolist() == [1, 1]
    assert packed(masks[:8], (1, 1, 2, 2), 8)[0, 0, 0, 0].tolist() == [1]
    assert packed(masks[:8], (1, 1, 2, 2), 9)[0, 0, 0, 0].tolist() == [1, 0]
    assert packed([], (1, 1, 2, 2), 1).shape == (1, 1, 2, 2, 1)
    assert not np.any(packed([], (1, 1, 2, 2), 12))


def test_scenes_of_eight_and_of_nine_objects_share_a_shard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(rendered, "ROWS", 9)
    standing = [(rendered.SPHERE, (0.2 + 0.09 * (i % 3), 0.09 * (i // 3 - 1), 0.04)) for i in range(9)]
    scenes = [rendered.scene(standing[:count], frames=1) for count in (8, 9)]
    records = [rendered.record(scene, resolution=(32, 32), edits=["remove"]) for scene in scenes]
    rendered.write_dataset(tmp_path, records)
    for read, record in zip(Dataset(tmp_path).split("train"), records, strict=True):
        for name, array in record.items():
            np.testing.assert_array_equal(read[name], array, err_msg=name)
    assert np.any(effect_mask(records[1]["edits/remove/effects"], 9))


def test_an_object_touches_all_pixels_that_carry_its_id_and_their_rim():
    world = rendered.scene()
    record = rendered.record(world)
    stage = stage_of(world, tuple(build(body.shape) for body in world.bodies), rendered.trajectory(world))
    for name, mask in touched(stage, record, make_renderer("raster")).items():
        own = record["segmentation"] == name
        assert np.all(mask[own])
        assert 0 < np.sum(mask & ~own) < np.sum(own)
