import math

import pytest
import torch

from obpose.errors import UsageError
from obpose.scenes import edit
from obpose.scenes.appearance.light import no_light
from obpose.scenes.appearance.table_texture import no_texture
from obpose.scenes.scene import Scene, upright
from tests.obpose.scenes.small_scenes import equal, some_scene

BY = torch.tensor([0.1, -0.2, 0.0])


def test_removed_is_removed_and_the_others_keep_their_names():
    scene = some_scene()
    without = edit.remove(scene, 2)
    assert without.ids == (1, 3)
    assert torch.equal(without.center, scene.center[:, [0, 2]])
    assert torch.equal(without.appearance.detail, scene.appearance.detail[[0, 2]])
    assert edit.remove(edit.remove(without, 1), 3).ids == ()


def test_an_object_moves_along_its_whole_way_and_nothing_else_does():
    scene = some_scene()
    there = edit.move(scene, 2, BY)
    torch.testing.assert_close(there.center[:, 1] - scene.center[:, 1], BY.expand(2, 3))
    assert torch.equal(there.center[:, [0, 2]], scene.center[:, [0, 2]])
    to = edit.move_to(scene, 3, BY)
    torch.testing.assert_close(to.center[0, 2], BY)
    torch.testing.assert_close(to.center[1, 2] - to.center[0, 2], scene.center[1, 2] - scene.center[0, 2])


def test_turning_turns_the_world_under_the_object():
    scene = some_scene()
    turned = edit.rotate(scene, 1, upright(math.pi, scene.center))
    torch.testing.assert_close(turned.rotation[:, 0, 2], scene.rotation[:, 0, 2], atol=1e-5, rtol=0)
    torch.testing.assert_close(turned.rotation[:, 0, :2], -scene.rotation[:, 0, :2], atol=1e-5, rtol=0)
    assert torch.equal(turned.center, scene.center)


def test_what_is_carried_along_keeps_its_corners_in_their_places():
    scene, transform = some_scene(), torch.eye(4)
    transform[:3, :3], transform[:3, 3] = upright(0.7, scene.center), BY
    carried = edit.carry(scene, 2, transform)
    corner = torch.tensor([0.1, 0.2, 0.3])
    before, after = (each.rotation[:, 1] @ corner + each.center[:, 1] for each in (scene, carried))
    torch.testing.assert_close(after, before @ transform[:3, :3].T + transform[:3, 3])
    assert torch.equal(carried.center[:, [0, 2]], scene.center[:, [0, 2]])
    assert equal(edit.carry(scene, 2, torch.eye(4)), scene)


def test_what_is_undone_is_as_before():
    scene = some_scene()
    quarter = upright(math.pi / 2, scene.center)
    assert equal(edit.swap(edit.swap(scene, 1, 3), 3, 1), scene)
    assert equal(edit.remove(edit.duplicate(scene, 2, BY), 4), scene)
    torch.testing.assert_close(edit.move(edit.move(scene, 2, BY), 2, -BY).center, scene.center)
    again = edit.rotate(edit.rotate(scene, 2, quarter), 2, quarter.T)
    torch.testing.assert_close(again.rotation, scene.rotation, atol=1e-5, rtol=0)


def test_an_object_cannot_change_places_with_itself():
    with pytest.raises(UsageError, match="Object 2 cannot change places with itself; name two objects"):
        edit.swap(some_scene(), 2, 2)


def test_swapped_objects_stay_what_they_are():
    scene = some_scene()
    swapped = edit.swap(scene, 1, 2)
    assert torch.equal(swapped.center[..., :2], scene.center[:, [1, 0, 2], :2])
    assert torch.equal(swapped.center[..., 2], scene.center[..., 2])
    assert torch.equal(swapped.what, scene.what)
    assert torch.equal(swapped.appearance.detail, scene.appearance.detail)
    assert torch.equal(swapped.rotation, scene.rotation)


def test_an_object_of_another_scene_is_added_and_stays_where_its_frames_end():
    source, target = some_scene(frames=2, seed=1), some_scene(frames=4)
    added = edit.transfer(source, 3, target)
    assert added.ids == (1, 2, 3, 4)
    frames = [0, 1, 1, 1]
    assert torch.equal(added.what[:, 3], source.what[frames, 2])
    assert torch.equal(added.appearance.detail[3], source.appearance.detail[2])
    assert torch.equal(added.center[:, 3], source.center[frames, 2])
    assert equal(edit.remove(added, 4), target)


def test_light_and_texture_stay_whatever_is_done_to_objects():
    scene = some_scene()
    source = some_scene(seed=1).with_appearance(light=no_light(), texture=no_texture())
    for changed in (*every_edit(scene), edit.transfer(source, 1, scene)):
        assert torch.equal(changed.appearance.light, scene.appearance.light)
        assert torch.equal(changed.appearance.texture, scene.appearance.texture)


def test_nothing_is_changed_in_place():
    scene, kept = some_scene(), some_scene()
    for changed in every_edit(scene):
        assert not equal(changed, scene)
        assert equal(scene, kept)


def every_edit(scene: Scene) -> list[Scene]:
    turn = torch.eye(4)
    turn[:3, :3] = upright(0.5, scene.center)
    return [
        edit.carry(scene, 1, turn),
        edit.remove(scene, 1),
        edit.move(scene, 1, BY),
        edit.move_to(scene, 1, BY),
        edit.rotate(scene, 1, upright(0.5, scene.center)),
        edit.swap(scene, 1, 2),
        edit.duplicate(scene, 1, BY),
        edit.transfer(some_scene(seed=1), 1, scene),
    ]


def test_objects_of_other_models_mean_nothing():
    with pytest.raises(UsageError, match="belong to different models"):
        edit.transfer(some_scene(model="abc"), 1, some_scene(model="xyz"))


def test_objects_that_are_alone_stay_so_and_others_do_not_become_it():
    scene = some_scene().with_appearance(own_scale=torch.tensor([0.0, 0.4, 0.6]))
    assert edit.remove(scene, 1).appearance.own_scale.tolist() == pytest.approx([0.4, 0.6])
    assert edit.remove(scene, 3).appearance.own_scale.tolist() == pytest.approx([0.0, 0.4])
    assert edit.duplicate(scene, 2, torch.zeros(3)).appearance.own_scale.tolist() == pytest.approx([0.0, 0.4, 0.6, 0.4])
    assert edit.transfer(scene, 3, some_scene()).appearance.own_scale.tolist() == pytest.approx([0.0, 0.0, 0.0, 0.6])
    assert edit.transfer(some_scene(), 3, scene).appearance.own_scale.tolist() == pytest.approx([0.0, 0.4, 0.6, 0.0])
