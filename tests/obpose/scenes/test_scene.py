import math
from dataclasses import replace

import pytest
import torch

from obpose.errors import UsageError
from obpose.geometry import camera_rays
from obpose.scenes.scene import LARGEST_ID, axis_rotation, upright
from tests.obpose.scenes.small_scenes import CAMERA, some_scene


def test_objects_keep_their_names_and_what_is_not_there_is_named():
    scene = some_scene(objects=2)
    assert [scene.place(name) for name in (1, 2)] == [0, 1]
    with pytest.raises(UsageError, match=r"no object 5\. Its objects are 1, 2\."):
        scene.place(5)
    with pytest.raises(UsageError, match="It has no objects"):
        some_scene(objects=0).place(1)


@pytest.mark.parametrize(("axis", "start", "end"), [("x", 1, 2), ("y", 2, 0), ("z", 0, 1)])
def test_a_quarter_turn_about_an_axis_takes_the_next_axis_to_the_one_after(axis, start: int, end: int):
    turn = axis_rotation(axis, math.pi / 2, torch.zeros(1))
    unit = torch.eye(3)
    torch.testing.assert_close(turn @ unit[start], unit[end], atol=1e-6, rtol=0)
    torch.testing.assert_close(turn @ turn.T, unit, atol=1e-6, rtol=0)
    torch.testing.assert_close(upright(0.3, torch.zeros(1)) @ unit[2], unit[2])


def test_a_camera_of_another_size_sees_the_same():
    wide = CAMERA.resized(64, 24)
    small, _ = camera_rays(CAMERA.k, CAMERA.world_from_camera, CAMERA.height, CAMERA.width)
    large, _ = camera_rays(wide.k, wide.world_from_camera, wide.height, wide.width)
    torch.testing.assert_close(large.reshape(12, 2, 16, 4, 3).mean(dim=(1, 3)), small)


def test_objects_look_alike_where_code_and_appearance_are_the_same():
    scene = some_scene(objects=2)
    look = scene.look(0, 0)
    assert replace(scene, center=scene.center + 1).look(0, 0) == look
    assert replace(scene, what=scene.what + 0.1).look(0, 0) != look
    for name in ("detail", "own_scale", "half_extent"):
        changed = scene.with_appearance(**{name: getattr(scene.appearance, name) + 0.1})
        assert changed.look(0, 0) != look


def test_new_names_follow_the_others_as_long_as_there_are_any():
    scene = some_scene(objects=2)
    assert scene.new_id() == 3
    assert replace(scene, ids=(1, LARGEST_ID)).new_id() == 2
    assert replace(scene, ids=(2, LARGEST_ID)).new_id() == 1
