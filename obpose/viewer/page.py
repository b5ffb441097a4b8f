"""The page: a session, its nodes and widgets, and the thread that renders it.

All browser windows share one session: an edit appears in all of them and can be undone in any. Each window has its
own camera. viser runs callbacks in its own threads; code that uses session, stage or panel holds the page's lock. The
lock is never held during rendering.
"""

import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import viser
from jaxtyping import Float
from torch import Tensor

from datagen.console.text import counted
from obpose.errors import DatagenError, UsageError
from obpose.scenes.infer import fit_to_frames
from obpose.scenes.refine import STEPS
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene
from obpose.viewer.drawing import Clouds, Drawer, Picture, Piece, Shape, Wish
from obpose.viewer.latest_worker import Newest
from obpose.viewer.opening import Opened
from obpose.viewer.panel import Actions, Panel
from obpose.viewer.panes import panes
from obpose.viewer.sampling import Sampler, checked_count
from obpose.viewer.saving import save_new
from obpose.viewer.scene3d import Events, Stage
from obpose.viewer.serving import close_server
from obpose.viewer.session import Session

_SECONDS = 8.0
"""Seconds a notification stays visible."""


class Page:
    """The page of one server."""

    def __init__(self, server: viser.ViserServer, opened: Opened, out: Path):
        """Build the page; scenes are saved into new folders in `out`."""
        self.title = opened.title
        self.server, self._opened, self._out = server, opened, out
        self._lock = threading.RLock()
        self.session = Session(opened.scene, opened.origin.model, opened.title)
        self._renderer, self._sampler = Renderer(opened.origin.model), Sampler(opened.origin)
        self.events = Events(select=self._toggle, look=self._look, drag=self._drag)
        self.actions = self._all_actions()
        self._stage = Stage(server, opened.origin.model, opened.scene, self.events)
        self._panel = Panel(server, self.session, self.actions, str(out), can_fit=opened.is_inferred)
        self._inputs_of: int | None = None
        self._wanted: tuple | None = None
        drawer = Drawer(self._renderer, opened.scene, opened.clip)
        self.work = Newest(drawer.draw, self._deliver, self._failed)
        self._refresh()

    def close(self) -> None:
        """Stop rendering and disconnect all browsers."""
        self.work.close()
        close_server(self.server)

    def _all_actions(self) -> Actions:
        return Actions(
            select=self._toggle,
            hide=lambda name: self._edit(lambda session: session.hide(name)),
            unhide=lambda name: self._edit(lambda session: session.unhide(name)),
            duplicate=lambda name: self._edit(lambda session: session.duplicate(name)),
            remove=lambda name: self._edit(lambda session: session.remove(name)),
            go_to_frame=self._go_to_frame,
            look=self._look,
            draw=lambda: self._edit(lambda _: None),
            undo=lambda: self._edit(lambda session: session.undo()),
            fit=lambda: self._run("Fitting to the frames, for some seconds", self._fit),
            sample=self._sample_wanted,
            save=self._save,
        )

    def _edit(self, change: Callable[[Session], None]) -> None:
        """Change the session and show the result; an edit may fail because of another window's edit."""
        with self._lock:
            try:
                change(self.session)
            except UsageError as error:
                self._tell("Not possible", str(error), "red")
            self._refresh()

    def _toggle(self, name: int | None) -> None:
        self._edit(lambda session: session.select(None if session.selected == name else name))

    def _go_to_frame(self, frame: int) -> None:
        # Widgets also call back for values that the page set itself.
        if frame != self.session.frame and frame < self.session.scene.frames:
            self._edit(lambda session: session.go_to_frame(frame))

    def _look(self, view: int) -> None:
        if view != self.session.view:
            self._edit(lambda session: session.look(view))

    def _drag(self, phase: str, at: Float[Tensor, "3"], turn: Float[Tensor, "3 3"]) -> None:
        def change(session: Session) -> None:
            if phase == "start":
                session.grab()
            elif phase == "update":
                session.drag(at, turn)
            else:
                session.drop()

        self._edit(change)

    def _fit(self) -> None:
        """Fit the inferred scene to its frames; edited scenes no longer match them."""
        scene, clip = self._opened.scene, self._opened.clip
        assert clip is not None
        with self._lock:
            self._check_as_inferred(self.session)
        fitted = fit_to_frames(scene, self._opened.origin.model, clip, refinements=STEPS)

        def change(session: Session) -> None:
            self._check_as_inferred(session)
            session.fit(fitted)

        self._edit(change)

    def _run(self, doing: str, job: Callable[[], None]) -> None:
        """Run a job in the render thread, and show its name on the page until it is done."""
        with self._lock:
            self._panel.begin(doing)

        def whole() -> None:
            try:
                job()
            finally:
                with self._lock:
                    self._panel.end(doing)

        self.work.run(whole)

    def _check_as_inferred(self, session: Session) -> None:
        if session.scene is not self._opened.scene:
            raise UsageError("The scene is no longer what was inferred; undo the edits, and fit again.")

    def _sample_wanted(self, objects: str) -> None:
        """Sample a scene with the chosen number of objects."""
        try:
            count = checked_count(objects)
        except UsageError as error:
            self._tell("Not possible", str(error), "red")
            return
        self._run("Sampling a new scene", lambda: self._sample(count))

    def _sample(self, objects: int) -> None:
        scene = self._sampler.next(objects, self._opened.scene.cameras)
        title = f"sampled with seed {self._sampler.seed}"
        self._edit(lambda session: session.replace(scene, title))
        self._tell("Sampled", f"{counted(objects, 'object')}, with seed {self._sampler.seed}")

    def _save(self) -> None:
        """Save the scene as it is now, regardless of edits before the job runs."""
        with self._lock:
            scene = self.session.scene
        self._run("Saving", lambda: self._write(scene))

    def _write(self, scene: Scene) -> None:
        folder = save_new(self._out, scene, self._renderer)
        self._tell("Saved", f"{folder}: {counted(scene.frames, 'frame')}, {counted(len(scene.ids), 'object')}", "green")

    def _refresh(self) -> None:
        """Show the current session and request the renderings it needs."""
        session = self.session
        self._stage.show(session, self._panel.layers)
        self._panel.show(session)
        self._show_inputs()
        wanted = session.version, session.hidden, session.frame, session.view
        if wanted != self._wanted:
            self._wanted = wanted
            self.work.wish(Wish(session.shown, session.frame, session.view, time.monotonic()))

    def _show_inputs(self) -> None:
        clip, frame = self._opened.clip, self.session.frame
        if clip is not None and frame != self._inputs_of:
            self._stage.put_inputs([_bytes(image) for image in clip.rgb[0, frame]])
            self._inputs_of = frame

    def _deliver(self, wish: Wish, piece: Piece) -> None:
        with self._lock:
            if isinstance(piece, Picture):
                self._put_picture(wish, piece)
            elif isinstance(piece, Shape):
                self._stage.put_shape(piece.name, piece.mesh)
            elif isinstance(piece, Clouds):
                self._stage.put_clouds(piece.clouds)
                self._stage.show(self.session, self._panel.layers)

    def _put_picture(self, wish: Wish, piece: Picture) -> None:
        clip, image = self._opened.clip, piece.image
        rgb = depth = None
        if clip is not None and self.session.version.seen_as is not None:
            rgb, depth = clip.rgb[0, wish.frame, wish.view], clip.depth[0, wish.frame, wish.view]
        height, width = image.depth.shape
        note = f"{width}x{height}, {time.monotonic() - wish.since:.2f} s after the last change"
        self._panel.put_picture(panes(image, rgb, depth), f"preview of {note}" if piece.is_preview else note)

    def _failed(self, error: Exception) -> None:
        if isinstance(error, DatagenError):
            self._tell("Not possible", str(error), "red")
        elif isinstance(error, OSError):
            place = f"{error.filename}: " if error.filename else ""
            self._tell("Not possible", f"{place}{error.strerror or error}", "red")
        else:
            # A mistake of ours: whoever started the page has to see where, and those who edit must not lose their work.
            traceback.print_exception(error, file=sys.stderr)
            self._tell("Something is wrong in the viewer itself", f"{type(error).__name__}: {error}", "red")

    def _tell(self, title: str, text: str, color: Literal["red", "green"] | None = None) -> None:
        for client in self.server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=_SECONDS, color=color)


def _bytes(image: Float[Tensor, "h w 3"]) -> np.ndarray:
    return (image * 255).round().to(torch.uint8).numpy()
