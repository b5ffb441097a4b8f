"""The page on its server, without a browser: what it serves, and what the controls do to the session."""

import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
import torch

from obpose.scenes.infer import infer_scene
from obpose.scenes.scene import upright
from obpose.scenes.storage import load_scene
from obpose.viewer.opening import Opened, open_path
from obpose.viewer.page import Page
from obpose.viewer.serving import open_server
from tests.obpose.scenes.small_scenes import alike, equal


@pytest.fixture(scope="module")
def opened(tiny_dataset: Path) -> Opened:
    """With a small picture."""
    found = open_path(tiny_dataset, checkpoint=None, data=None, split="test", index=0)
    cameras = tuple(camera.resized(16, 16) for camera in found.scene.cameras)
    return replace(found, scene=replace(found.scene, cameras=cameras))


@pytest.fixture
def page(opened: Opened, tmp_path: Path) -> Iterator[Page]:
    found = Page(open_server("127.0.0.1", free_port(), "a test"), opened, tmp_path / "saved")
    yield found
    found.close()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def settled(page: Page) -> Page:
    assert page.work.wait(120.0)
    return page


def test_it_is_served_on_loopback_and_shows_points_shapes_and_pictures(page: Page):
    server = settled(page).server
    assert server.get_host() == "127.0.0.1"
    with urlopen(f"http://127.0.0.1:{server.get_port()}") as answer:
        assert b"<html" in answer.read().lower()
    shown = [server.scene.get_handle_by_name(name) for name in nodes(page)]
    assert all(node is not None for node in shown)


def nodes(page: Page) -> list[str]:
    objects = [
        f"/objects/{name}/{part}" for name in page.session.scene.ids for part in ("box", "label", "points", "shape")
    ]
    return ["/background", "/table", "/gizmo", "/cameras/0", *objects]


def test_nodes_follow_the_session(page: Page):
    node = settled(page).server.scene.get_handle_by_name
    name, scene = page.session.scene.ids[0], page.session.scene
    page.actions.remove(name)
    assert node(f"/objects/{name}") is None
    page.actions.undo()
    settled(page)
    assert node(f"/objects/{name}/shape") is not None
    page.actions.hide(name)
    assert not node(f"/objects/{name}").visible
    page.actions.unhide(name)
    page.actions.go_to_frame(3)
    np.testing.assert_allclose(node(f"/objects/{name}").position, scene.center[3, 0])


def test_dragging_is_followed_and_undone_as_one(page: Page):
    before, name = page.session.scene, page.session.scene.ids[0]
    page.events.select(name)
    to = before.center[0, 0] + torch.tensor([0.1, 0.0, 0.0])
    page.events.drag("start", before.center[0, 0], torch.eye(3))
    for share in (0.5, 1.0):
        page.events.drag("update", before.center[0, 0].lerp(to, share), upright(share, to))
    page.events.drag("end", to, upright(1.0, to))
    node = page.server.scene.get_handle_by_name
    np.testing.assert_allclose(node(f"/objects/{name}").position, to, atol=1e-6)
    np.testing.assert_allclose(node("/gizmo").position, to, atol=1e-6)
    assert node("/gizmo").wxyz.tolist() == [1, 0, 0, 0]  # the next turn begins anew
    page.actions.undo()
    assert page.session.scene is before


def test_what_was_inferred_is_fitted_to_its_frames_once_and_can_be_undone(
    page: Page, opened: Opened, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("obpose.viewer.page.STEPS", 5)
    page.actions.fit()
    fitted = settled(page).session.scene
    assert fitted.appearance.detail.any()
    assert alike(fitted, infer_scene(opened.origin, opened.clip, refinements=5), by=0.01)
    assert page.session.version.seen_as == {name: name for name in opened.scene.ids}
    page.actions.fit()
    assert settled(page).session.scene is fitted
    page.actions.undo()
    assert page.session.scene is opened.scene


def test_a_sampled_scene_replaces_all_and_has_no_input(page: Page):
    before = page.session.scene
    page.actions.sample("2")
    settled(page)
    assert page.session.scene.ids == (1, 2)
    assert page.session.scene.frames == 1
    node = page.server.scene.get_handle_by_name
    assert node("/objects/1/points") is None
    assert not node("/background").visible
    page.actions.undo()
    settled(page)
    assert page.session.scene is before
    assert node("/background").visible
    assert node(f"/objects/{before.ids[0]}/points") is not None


@pytest.mark.parametrize("count", ["", "abc", "-1", "9", "1e9", "2.5", "nan", "9" * 5000, "٣", " 2"])
def test_other_numbers_of_new_objects_are_refused(page: Page, count: str, monkeypatch: pytest.MonkeyPatch):
    before, said = page.session.version, []
    monkeypatch.setattr(page, "_tell", lambda title, text, colour=None: said.append(text))
    page.actions.sample(count)
    assert settled(page).session.version is before
    assert len(said) == 1
    assert said[0].endswith("expected a whole number from 0 to 8.")
    assert len(said[0]) < 100


def test_the_title_is_that_of_what_is_shown(page: Page, opened: Opened, monkeypatch: pytest.MonkeyPatch):
    titles: list[str] = []
    monkeypatch.setattr(page.server.gui, "set_panel_label", titles.append)
    page.actions.sample("1")
    settled(page)
    page.actions.sample("1")
    settled(page)
    page.actions.undo()
    page.actions.undo()
    seeds = [f"sampled with seed {seed}" for seed in (0, 1)]
    assert titles == [*seeds, seeds[0], opened.title]


def test_it_says_what_it_is_doing_until_it_is_done(page: Page):
    settled(page)
    panel, go_on = page._panel, threading.Event()
    assert not panel._running.visible
    page.work.run(lambda: go_on.wait(60) and None)
    page.actions.sample("1")
    page.actions.save()
    assert panel._running.visible
    assert "Sampling a new scene ..." in panel._busy.content
    assert all(button.disabled for button in (*panel._jobs, panel._fit))
    go_on.set()
    settled(page)
    assert not panel._running.visible
    assert not any(button.disabled for button in panel._jobs)
    assert panel._fit.disabled  # another scene is shown
    page.actions.undo()
    assert not panel._fit.disabled


def test_a_job_that_fails_ends_as_well(page: Page, tmp_path: Path):
    settled(page)
    (tmp_path / "saved").write_text("a file")
    page.actions.save()
    settled(page)
    assert not page._panel._running.visible


def test_what_is_saved_can_be_opened_again(page: Page, tmp_path: Path):
    page.actions.duplicate(page.session.scene.ids[0])
    page.actions.save()
    page.actions.save()
    settled(page)
    assert sorted(path.name for path in (tmp_path / "saved").iterdir()) == ["scene-1", "scene-2"]
    assert equal(load_scene(tmp_path / "saved" / "scene-1"), page.session.scene)


def test_a_scene_is_saved_as_it_was_when_the_button_was_pressed(page: Page, tmp_path: Path):
    pressed, go_on = page.session.scene, threading.Event()
    page.work.run(lambda: go_on.wait(60) and None)
    page.actions.save()
    page.actions.remove(pressed.ids[0])
    go_on.set()
    settled(page)
    assert equal(load_scene(tmp_path / "saved" / "scene-1"), pressed)


def test_what_two_windows_do_at_once_is_no_mistake(page: Page):
    name = page.session.scene.ids[0]
    page.actions.remove(name)
    before = page.session.version
    for act in (page.actions.remove, page.actions.hide, page.actions.duplicate, page.events.select):
        act(name)
    assert page.session.version is before
