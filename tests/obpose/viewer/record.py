"""Record a session of the page as an animation: python -m tests.obpose.viewer.record DATA OUT.webp."""

import sys
import tempfile
from contextlib import chdir
from pathlib import Path

from PIL import Image

from obpose.viewer.page import Page
from obpose.viewer.scene_io import open_path
from obpose.viewer.server import open_server
from tests.browser import browser
from tests.obpose.viewer.driving import User, free_port

WINDOW = (1120, 880)
SIZE = (720, 566)
SECONDS, LONGER = 0.25, 1.5


class Film:
    """Screenshots and their durations in seconds."""

    def __init__(self, user: User, folder: Path):
        self._user, self._path = user, folder / "frame.png"
        self._frames: list[Image.Image] = []
        self._seconds: list[float] = []

    def take(self, seconds: float = SECONDS) -> None:
        self._user.tab.screenshot(self._path)
        with Image.open(self._path) as found:
            self._frames.append(found.convert("RGB").resize(SIZE, Image.Resampling.LANCZOS))
        self._seconds.append(seconds)

    def write(self, path: Path) -> None:
        """Write all frames."""
        first, *rest = self._frames
        durations = [round(1000 * seconds) for seconds in self._seconds]
        first.save(path, "WEBP", save_all=True, append_images=rest, duration=durations, loop=0, quality=85, method=6)


def play(user: User, film: Film) -> None:
    """Fit, orbit, go through the frames, move, copy and remove objects, undo, sample, save."""
    film.take(LONGER)
    user.press("Fit to the frames")
    settled(user, film)
    user.orbit(-70, look=film.take)
    for share in (0.33, 0.67, 0.0):
        user.slide(share)
        settled(user, film)
    user.press("move")
    settled(user, film)
    user.drag_gizmo((0.0, -0.15, 0.0), look=film.take)
    settled(user, film)
    for label in ("copy", "remove", "Undo", "Sample a new scene", "Undo", "Save"):
        user.press(label)
        settled(user, film)


def settled(user: User, film: Film) -> None:
    user.settle()
    film.take(LONGER)


def main(data: str, out: str) -> None:
    opened = open_path(Path(data), checkpoint=None, data=None, split="test", index=0)
    path = Path(out).absolute()
    with tempfile.TemporaryDirectory() as name, chdir(name):
        page = Page(open_server("127.0.0.1", free_port(), opened.title), opened, Path("scenes"))
        address = f"http://127.0.0.1:{page.server.get_port()}"
        with browser(address, Path(name) / "profile", width=WINDOW[0], height=WINDOW[1]) as tab:
            user = User(tab, page)
            film = Film(user, Path(name))
            play(user, film)
            film.write(path)
        page.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
