import math

import pytest
import torch

from obpose.errors import UsageError
from obpose.scenes.bounds import check_inside
from obpose.scenes.scene import upright
from obpose.viewer.session import Session
from tests.obpose.scenes.small_scenes import equal, some_model, some_scene

TURN = upright(math.pi / 3, torch.zeros(()))


def some_session(**sizes: int) -> Session:
    return Session(some_scene(**sizes), some_model())


def edited(session: Session) -> list[str]:
    """Make one edit of each kind, and give their names."""
    session.remove(1)
    session.duplicate(2)
    session.grab()
    session.drag(torch.tensor([0.1, 0.2, 0.0]), TURN)
    session.drop()
    session.replace(some_scene(seed=1, frames=1))
    return ["remove", "duplicate", "drag", "replace"]


def test_every_edit_is_undone_one_by_one():
    session = some_session()
    before = session.scene
    assert not session.can_undo
    for _ in edited(session):
        assert session.can_undo
        session.undo()
    assert session.scene is before
    assert not session.can_undo
    session.undo()
    assert session.scene is before


def test_a_drag_is_one_edit():
    session = some_session()
    before = session.scene
    session.select(2)
    session.grab()
    for step in range(5):
        session.drag(torch.tensor([0.05 * step, 0.0, 0.1]), upright(0.1 * step, before.center))
    session.drop()
    torch.testing.assert_close(session.scene.center[0, 1], torch.tensor([0.2, 0.0, 0.1]))
    torch.testing.assert_close(session.scene.rotation[:, 1], upright(0.4, before.center) @ before.rotation[:, 1])
    session.undo()
    assert session.scene is before
    assert not session.can_undo


def test_a_drag_is_of_this_frame_and_displaces_the_whole_way():
    session = some_session()
    before = session.scene
    session.go_to_frame(1)
    session.select(1)
    session.grab()
    to = torch.tensor([0.0, 0.0, 0.2])
    session.drag(to, torch.eye(3))
    session.drop()
    torch.testing.assert_close(session.scene.center[1, 0], to)
    torch.testing.assert_close(session.scene.center[0, 0], before.center[0, 0] - before.center[1, 0] + to)


def test_a_grab_without_movement_is_no_edit():
    session = some_session()
    session.select(1)
    session.grab()
    session.drop()
    assert not session.can_undo


def test_only_a_grabbed_object_is_dragged():
    session = some_session()
    session.grab()
    session.drag(torch.zeros(3), TURN)
    session.select(1)
    session.drag(torch.zeros(3), TURN)
    assert not session.can_undo


def test_a_drag_stops_at_the_workspace_in_all_frames():
    session = some_session()
    session.select(3)
    session.grab()
    session.drag(torch.tensor([9.0, -9.0, -9.0]), torch.eye(3))
    session.drop()
    half = 1.0 / 2
    center = session.scene.center[:, 2]
    assert float(center[:, 0].max()) == pytest.approx(half)
    assert float(center[:, 1].min()) == pytest.approx(-half)
    assert float(center[:, 2].min()) == pytest.approx(0, abs=1e-6)
    check_inside(session.scene, some_model())


def test_a_hidden_object_stays_in_the_scene():
    session = some_session()
    before = session.scene
    session.select(2)
    session.hide(2)
    assert session.shown.ids == (1, 3)
    assert session.scene is before
    assert session.selected is None
    session.unhide(2)
    assert equal(session.shown, before)
    assert not session.can_undo


def test_undo_keeps_objects_hidden():
    session = some_session()
    session.hide(3)
    session.remove(3)
    session.duplicate(1)
    session.hide(2)
    session.unhide(1)
    session.undo()
    assert session.hidden == {2}
    session.undo()
    assert session.hidden == {2, 3}
    assert session.shown.ids == (1,)
    session.unhide(3)
    assert session.hidden == {2}


def test_another_scene_hides_nothing_and_undo_restores_hidden_objects():
    session = some_session()
    session.hide(2)
    session.select(1)
    session.replace(some_scene(seed=1))
    assert session.hidden == frozenset()
    assert session.selected is None
    assert session.version.sources is None
    session.undo()
    assert session.hidden == {2}


def test_a_copy_is_selected_at_a_free_place_and_keeps_its_source():
    session = some_session()
    session.duplicate(2)
    session.duplicate(4)
    assert session.selected == 5
    assert session.version.sources == {1: 1, 2: 2, 3: 3, 4: 2, 5: 2}
    center = session.scene.center[0]
    assert float(torch.cdist(center[3:4], center[:3]).min()) > 0.05


def test_frame_and_view_are_limited_to_the_scene():
    session = some_session(frames=4)
    session.go_to_frame(3)
    session.replace(some_scene(frames=1))
    assert session.frame == 0
    session.go_to_view(5)
    assert session.view == 0


@pytest.mark.parametrize("act", ["select", "hide", "remove", "duplicate"])
def test_edits_of_missing_objects_fail_and_change_nothing(act: str):
    session = some_session()
    before = session.version
    with pytest.raises(UsageError, match="no object 9"):
        getattr(session, act)(9)
    assert session.version is before
    assert not session.can_undo


def test_a_hidden_object_can_be_removed():
    session = some_session()
    session.hide(2)
    session.remove(2)
    assert session.shown.ids == (1, 3)
    session.undo()
    assert session.hidden == {2}


@pytest.mark.parametrize("act", ["drop", "grab", "remove", "duplicate", "replace", "fit"])
def test_an_edit_during_a_drag_comes_after_the_drag(act: str):
    session = some_session()
    before = session.scene
    session.select(1)
    session.grab()
    session.drag(torch.tensor([0.1, 0.1, 0.1]), TURN)
    dragged = session.scene
    acts = {"remove": (2,), "duplicate": (2,), "replace": (some_scene(seed=1),), "fit": (some_scene(seed=2),)}
    getattr(session, act)(*acts.get(act, ()))
    if act in acts:
        session.undo()
    assert session.scene is dragged
    session.undo()
    assert session.scene is before
    assert not session.can_undo


def test_undo_reverts_a_drag_in_progress():
    session = some_session()
    before = session.scene
    session.select(1)
    session.grab()
    session.drag(torch.tensor([0.1, 0.1, 0.1]), TURN)
    session.undo()
    assert session.scene is before
    assert not session.is_dragging
