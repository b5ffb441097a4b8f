"""The page on its server, without a browser."""

import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
import torch

from obpose.scenes.scene import upright
from obpose.scenes.storage import load_scene
from obpose.viewer.page import Page
from obpose.viewer.scene_io import OpenedScene, open_path
from obpose.viewer.server import open_server
from obpose.viewer.session import Session
from tests.obpose.scenes.small_scenes import equal
from tests.obpose.viewer.driving import free_port


class RecordingPage(Page):
    """A page that records its notifications."""

    def _notify(self, title: str, text: str, color: str | None = None) -> None:
        self.__dict__.setdefault("notifications", []).append(f"{title}: {text}")


@pytest.fixture(scope="module")
def opened(tiny_dataset: Path) -> OpenedScene:
    return open_path(tiny_dataset, checkpoint=None, data=None, split="test", index=0)


@pytest.fixture
def page(opened: OpenedScene, tmp_path: Path) -> Iterator[RecordingPage]:
    server = open_server("127.0.0.1", free_port(), "a test")
    found = RecordingPage(server, opened, tmp_path / "saved", preview=8, final=16, fit_steps=5)
    yield found
    found.close()


def settled(page: Page) -> Page:
    assert page.worker.wait(120.0)
    return page


def test_it_is_served_on_loopback_with_points_boxes_and_shapes(page: Page):
    server = settled(page).server
    assert server.get_host() == "127.0.0.1"
    with urlopen(f"http://127.0.0.1:{server.get_port()}") as answer:
        assert b"<html" in answer.read().lower()
    parts = ("box", "label", "points", "shape")
    objects = [f"/objects/{name}/{part}" for name in page.session.scene.ids for part in parts]
    for name in ("/background", "/table", "/gizmo", "/cameras/0", *objects):
        assert server.scene.get_handle_by_name(name) is not None


def test_an_object_is_drawn_as_its_shape_or_as_its_points(page: Page):
    node, name = settled(page).server.scene.get_handle_by_name, page.session.scene.ids[0]

    def visible() -> tuple[bool, bool]:
        return tuple(node(f"/objects/{name}/{part}").visible for part in ("shape", "points"))

    assert visible() == (True, False)
    page.panel._drawn_as.value = "points by object"
    page.edit(lambda session: None)
    tinted = node(f"/objects/{name}/points").colors
    assert visible() == (False, True)
    page.panel._drawn_as.value = "points as observed"
    page.edit(lambda session: None)
    assert visible() == (False, True)
    assert not np.array_equal(node(f"/objects/{name}/points").colors, tinted)


def test_nodes_follow_the_session(page: Page):
    node = settled(page).server.scene.get_handle_by_name
    name, scene = page.session.scene.ids[0], page.session.scene
    page.edit(lambda session: session.remove(name))
    assert node(f"/objects/{name}") is None
    page.edit(Session.undo)
    settled(page)
    assert node(f"/objects/{name}/shape") is not None
    page.edit(lambda session: session.hide(name))
    assert not node(f"/objects/{name}").visible
    page.edit(lambda session: session.unhide(name))
    page.edit(lambda session: session.go_to_frame(3))
    np.testing.assert_allclose(node(f"/objects/{name}").position, scene.center[3, 0])


def test_a_drag_moves_the_nodes_and_is_undone_as_one(page: Page):
    before, name = page.session.scene, page.session.scene.ids[0]
    to = before.center[0, 0] + torch.tensor([0.1, 0.0, 0.0])
    page.edit(lambda session: session.toggle(name))
    page.edit(Session.grab)
    for share in (0.5, 1.0):
        page.edit(lambda session, share=share: session.drag(before.center[0, 0].lerp(to, share), upright(share, to)))
    page.edit(Session.drop)
    node = page.server.scene.get_handle_by_name
    np.testing.assert_allclose(node(f"/objects/{name}").position, to, atol=1e-6)
    np.testing.assert_allclose(node("/gizmo").position, to, atol=1e-6)
    assert node("/gizmo").wxyz.tolist() == [1, 0, 0, 0]  # the next rotation starts from here
    page.edit(Session.undo)
    assert page.session.scene is before


def test_an_inferred_scene_is_fitted_once_and_the_fit_can_be_undone(page: Page, opened: OpenedScene):
    page.fit()
    fitted = settled(page).session.scene
    assert fitted.appearance.detail.any()
    assert page.session.version.sources == {name: name for name in opened.scene.ids}
    page.fit()
    assert settled(page).session.scene is fitted
    page.edit(Session.undo)
    assert page.session.scene is opened.scene


def test_a_sampled_scene_has_a_title_and_no_input(page: Page, opened: OpenedScene):
    titles, set_label = [], page.server.gui.set_panel_label
    page.server.gui.set_panel_label = lambda title: (titles.append(title), set_label(title))[1]
    node = page.server.scene.get_handle_by_name
    for count in ("1", "2"):
        page.sample(count)
        settled(page)
    assert (page.session.scene.ids, page.session.scene.frames) == ((1, 2), 1)
    assert node("/objects/1/points") is None
    assert not node("/background").visible
    assert "sampled with seed 1 - obpose-view" in page.panel._window_title.content
    for _ in range(2):
        page.edit(Session.undo)
    settled(page)
    assert titles == ["sampled with seed 0", "sampled with seed 1", "sampled with seed 0", opened.title]
    assert page.session.scene is opened.scene
    assert node("/background").visible
    assert node(f"/objects/{opened.scene.ids[0]}/points") is not None


def test_other_numbers_of_new_objects_are_refused(page: RecordingPage):
    before = page.session.version
    for count in ("", "abc", "-1", "9", "1e9", "2.5", "nan", "9" * 5000, "٣", " 2"):
        page.sample(count)
        assert settled(page).session.version is before
        said = page.notifications.pop()
        assert said.endswith("expected a whole number from 0 to 8.")
        assert len(said) < 120


def test_running_jobs_are_shown_and_disable_their_buttons(page: Page):
    panel, go_on = settled(page).panel, threading.Event()
    page.worker.run(lambda: go_on.wait(60) and None)
    page.sample("1")
    page.save()
    buttons = (panel._save, panel._sample, panel._fit)
    assert (panel.is_busy, panel._bar.value, panel._bar.animated) == (True, 100, True)
    assert "Sampling a new scene ..." in panel._status.content
    assert all(button.disabled for button in buttons)
    go_on.set()
    settled(page)
    assert (panel.is_busy, panel._bar.value, panel._bar.animated) == (False, 0, False)
    assert "16x16" in panel._status.content
    assert [button.disabled for button in buttons] == [False, False, True]  # another scene has no frames
    page.edit(Session.undo)
    assert not panel._fit.disabled


def test_a_failed_job_is_reported_and_no_longer_shown(page: RecordingPage, tmp_path: Path):
    (tmp_path / "saved").write_text("a file")
    page.save()
    assert not settled(page).panel.is_busy
    assert "saved is a file" in page.notifications[-1]


def test_a_scene_is_saved_as_it_was_when_the_button_was_pressed(page: Page, tmp_path: Path):
    pressed, go_on = page.session.scene, threading.Event()
    page.worker.run(lambda: go_on.wait(60) and None)
    page.save()
    page.edit(lambda session: session.remove(pressed.ids[0]))
    page.save()
    go_on.set()
    settled(page)
    assert equal(load_scene(tmp_path / "saved" / "scene-1"), pressed)
    assert equal(load_scene(tmp_path / "saved" / "scene-2"), page.session.scene)


def test_simultaneous_edits_of_two_windows_are_harmless(page: Page):
    name = page.session.scene.ids[0]
    page.edit(lambda session: session.remove(name))
    before = page.session.version
    for act in (Session.remove, Session.hide, Session.duplicate, Session.toggle):
        page.edit(lambda session, act=act: act(session, name))
    assert page.session.version is before
