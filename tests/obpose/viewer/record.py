"""Record the page being used, as an animation: python -m tests.obpose.viewer.record DATA OUT.gif."""

import io
import sys
import tempfile
from contextlib import chdir
from pathlib import Path

from PIL import Image

from obpose.viewer.opening import open_path
from obpose.viewer.page import Page
from obpose.viewer.serving import open_server
from tests.browser import browser
from tests.obpose.viewer.driving import Person
from tests.obpose.viewer.test_page import free_port

WINDOW = (1120, 880)
SIZE, COLOURS = (720, 566), 256
SECONDS, LONGER = 0.25, 1.5


class Film:
    """Screenshots, and for how many seconds each is seen."""

    def __init__(self, person: Person, folder: Path):
        self._person, self._path = person, folder / "frame.png"
        self._frames: list[Image.Image] = []
        self._seconds: list[float] = []

    def take(self, seconds: float = SECONDS) -> None:
        self._person.tab.screenshot(self._path)
        with Image.open(self._path) as found:
            self._frames.append(found.convert("RGB").resize(SIZE, Image.Resampling.LANCZOS))
        self._seconds.append(seconds)

    def write(self, path: Path) -> None:
        """All frames in the colours of the whole film, so that what stands still costs nothing."""
        sheet = Image.new("RGB", (SIZE[0], SIZE[1] * len(self._frames)))
        for place, frame in enumerate(self._frames):
            sheet.paste(frame, (0, place * SIZE[1]))
        palette = sheet.quantize(COLOURS)
        first, *rest = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in self._frames)
        data = io.BytesIO()
        durations = [round(1000 * seconds) for seconds in self._seconds]
        first.save(data, "GIF", save_all=True, append_images=rest, duration=durations, loop=0, optimize=True)
        path.write_bytes(data.getvalue())


def play(person: Person, film: Film) -> None:
    """Fit, look around, go through time, move an object, copy it, remove one, take that back, sample, save."""
    film.take(LONGER)
    person.press("Fit to the frames")
    settled(person, film)
    person.orbit(-70, look=film.take)
    for share in (0.33, 0.67, 0.0):
        person.slide(share)
        settled(person, film)
    person.press("move")
    settled(person, film)
    person.drag_gizmo((0.0, -0.15, 0.0), look=film.take)
    settled(person, film)
    for label in ("copy", "remove", "Undo", "Sample a new scene", "Undo", "Save"):
        person.press(label)
        settled(person, film)


def settled(person: Person, film: Film) -> None:
    person.settle()
    film.take(LONGER)


def main(data: str, out: str) -> None:
    opened = open_path(Path(data), checkpoint=None, data=None, split="test", index=0)
    path = Path(out).absolute()
    with tempfile.TemporaryDirectory() as name, chdir(name):
        page = Page(open_server("127.0.0.1", free_port(), opened.title), opened, Path("scenes"))
        address = f"http://127.0.0.1:{page.server.get_port()}"
        with browser(address, Path(name) / "profile", width=WINDOW[0], height=WINDOW[1]) as tab:
            person = Person(tab, page)
            film = Film(person, Path(name))
            play(person, film)
            film.write(path)
        page.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
