"""A simulated user of the page: presses its buttons, turns the view, and drags the gizmo, in a browser."""

import socket
import time
from collections.abc import Callable

import numpy as np
from viser import transforms

from obpose.viewer.page import Page
from tests.browser import Tab
from tests.processes import wait_until

SHOWN = "document.querySelector('canvas') && document.body.innerText.includes('after the last change')"
BUTTON = "[...document.querySelectorAll('button')].filter(found => found.innerText.trim() == {label!r})[{place}]"

CENTER = """(() => {{
    const found = {button};
    if (!found || found.disabled) return null;
    found.scrollIntoView({{block: 'nearest'}});
    const box = found.getBoundingClientRect(), center = [box.x + box.width / 2, box.y + box.height / 2];
    return found.contains(document.elementFromPoint(...center)) && center;
}})()"""
"""Center of a button, or nothing while it cannot be clicked."""

ARC = 0.65
"""Radius of viser's arcs, in the scale of the gizmo."""


def free_port() -> int:
    """A port of this machine that no process uses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class User:
    """User of the first tab that opened the page."""

    def __init__(self, tab: Tab, page: Page):
        self.tab, self.page = tab, page
        tab.wait(SHOWN, seconds=240)
        # Close viser's notification about the missing graphics card.
        tab.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(found => found.click())")
        wait_until(lambda: page.server.get_clients(), seconds=60, what="the page to report its camera")
        self.settle()
        time.sleep(3.0)  # viser fades in

    def settle(self) -> None:
        """Wait until everything is rendered and displayed."""
        time.sleep(1.0)  # until the click reaches the server
        assert self.page.worker.wait(240.0)
        time.sleep(1.0)

    def press(self, label: str, place: int = 0) -> None:
        """Click a button once it is enabled and rests; `place` chooses between several with this label."""
        center = CENTER.format(button=BUTTON.format(label=label, place=place))
        previous = None
        # Buttons move while pictures above them load; a click at their last place would miss.
        while (now := self.tab.wait(center)) != previous:
            previous = now
            time.sleep(0.3)
        self.tab.click(*now)

    def slide(self, share: float) -> None:
        """Click the slider of frames at this share of its width."""
        box = "document.querySelector('.mantine-Slider-trackContainer').getBoundingClientRect()"
        x, y, width, height = self.tab.evaluate(f"(({{x, y, width, height}}) => [x, y, width, height])({box})")
        self.tab.click(x + share * width, y + height / 2)

    def orbit(self, pixels: float, look: Callable[[], None] = lambda: None) -> None:
        """Turn the view by dragging over the table; `look` is called during the drag."""
        x, y, width, height = self.canvas()
        start = (x + 0.25 * width, y + 0.8 * height)
        self.tab.drag(start, (start[0] + pixels, start[1]), look=look)

    def drag_gizmo(self, by: tuple[float, float, float], look: Callable[[], None] = lambda: None) -> None:
        """Drag an arrow of the gizmo; `look` is called during the drag.

        Args:
            by: Displacement along one axis of the world, metres.
            look: Called after each step, for example to take a screenshot.
        """
        gizmo = self.page.server.scene.get_handle_by_name("/gizmo")
        middle, scale = np.array(gizmo.position), gizmo.scale  # pyright: ignore
        axis = np.array(by) / np.linalg.norm(by)
        start = middle + 0.6 * scale * abs(axis)
        self.tab.drag(self.pixel(start), self.pixel(start + np.array(by)), look=look)

    def turn_gizmo(self, degrees: float) -> None:
        """Drag the gizmo's arc around the world's z axis by an angle."""
        gizmo = self.page.server.scene.get_handle_by_name("/gizmo")
        middle, radius = np.array(gizmo.position), ARC * gizmo.scale  # pyright: ignore
        angles = np.radians([45.0, 45.0 + degrees])
        start, end = (middle + radius * np.array([np.cos(angle), np.sin(angle), 0.0]) for angle in angles)
        self.tab.drag(self.pixel(start), self.pixel(end))

    def pixel(self, point: np.ndarray) -> tuple[float, float]:
        """Project a world point to pixels of the page."""
        camera = next(iter(self.page.server.get_clients().values())).camera
        left, top, width, height = self.canvas()
        x, y, z = transforms.SO3(camera.wxyz).inverse().apply(point - camera.position)
        focal = height / 2 / np.tan(camera.fov / 2)
        return float(left + width / 2 + focal * x / z), float(top + height / 2 + focal * y / z)

    def canvas(self) -> tuple[float, float, float, float]:
        """Left, top, width and height of the three-dimensional view, pixels of the page."""
        box = "document.querySelector('canvas').getBoundingClientRect()"
        return tuple(self.tab.evaluate(f"(({{x, y, width, height}}) => [x, y, width, height])({box})"))
