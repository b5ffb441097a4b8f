"""Chromium without a window, for tests of pages: driven over its debugging protocol, with WebGL in software."""

import base64
import itertools
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), "")
MISSING = "needs Chromium or Chrome on the PATH, such as Debian's package chromium"
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
    "--remote-allow-origins=*",
)


class Tab:
    """One page."""

    def __init__(self, socket: Any):
        self._socket, self._numbers = socket, itertools.count(1)
        self.complaints: list[str] = []
        """Errors and exceptions on the page's console."""
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Run a method of the protocol."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=120))
            if answer.get("id") == number:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]
            self._listen(answer)

    def evaluate(self, script: str) -> Any:
        """Value of an expression in the page; promises are waited for."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, script: str, *, seconds: float = 60) -> Any:
        """Wait until an expression is true in the page, and give its value."""
        deadline = time.monotonic() + seconds
        while not (value := self.evaluate(script)):
            assert time.monotonic() < deadline, f"waited {seconds:g} s for {script}"
            time.sleep(0.1)
        return value

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """A mouse event: `Pressed`, `Moved` or `Released`, pixels of the page."""
        held = {"button": "left", "buttons": 0 if kind == "Released" else 1, "clickCount": 1} | more
        self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **held)

    def hover(self, x: float, y: float) -> None:
        """Move the mouse without a button."""
        self.mouse("Moved", x, y, button="none", buttons=0, clickCount=0)

    def click(self, x: float, y: float) -> None:
        """Press and release."""
        self.hover(x, y)
        self.mouse("Pressed", x, y)
        self.mouse("Released", x, y)

    def drag(
        self,
        start: tuple[float, float],
        end: tuple[float, float],
        *,
        steps: int = 6,
        look: Callable[[], None] = lambda: None,
    ) -> None:
        """Press, move in equal steps, after each of which something may look, release."""
        self.hover(*start)
        time.sleep(0.3)
        self.mouse("Pressed", *start)
        for step in range(1, steps + 1):
            share = step / steps
            self.mouse("Moved", *(a + (b - a) * share for a, b in zip(start, end, strict=True)))
            time.sleep(0.05)
            look()
        self.mouse("Released", *end)

    def screenshot(self, path: Path) -> None:
        """Write a PNG of what is seen."""
        path.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"]))

    def _listen(self, event: dict[str, Any]) -> None:
        if event.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(json.dumps(event["params"]["exceptionDetails"])[:500])
        elif event.get("method") == "Log.entryAdded" and event["params"]["entry"]["level"] == "error":
            entry = event["params"]["entry"]
            # Pictures that were replaced while the page was loading them.
            if not entry.get("url", "").startswith("blob:"):
                self.complaints.append(json.dumps(entry)[:500])


@contextmanager
def browser(address: str, profile: Path, *, width: int = 1280, height: int = 800) -> Iterator[Tab]:
    """A tab with a page, in a browser of its own that ends afterwards."""
    from websockets.sync.client import connect

    command = [BROWSER, *FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}", "about:blank"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            with connect(_tab_address(profile), max_size=None, proxy=None) as socket:
                tab = Tab(socket)
                tab.call(
                    "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
                )
                tab.call("Page.navigate", url=address)
                yield tab
        finally:
            process.terminate()


def _tab_address(profile: Path) -> str:
    """Address of the debugging socket of the first tab."""
    from urllib.request import urlopen

    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            port = (profile / "DevToolsActivePort").read_text().splitlines()[0]
            with urlopen(f"http://127.0.0.1:{port}/json") as answer:
                tabs = [tab for tab in json.load(answer) if tab["type"] == "page"]
            return tabs[0]["webSocketDebuggerUrl"]
        except (OSError, IndexError):
            time.sleep(0.1)
    raise AssertionError("the browser did not start within a minute")
