"""The page: a session, its 3D scene and controls, and the thread that renders it.

All browser windows share one session: an edit appears in all of them and can be undone in any. Each window has its
own camera. viser runs callbacks in its own threads; code that uses session, 3D scene or panel holds the page's lock.
The lock is never held during rendering.
"""

import sys
import threading
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import viser

from datagen.console.text import counted
from obpose.errors import DatagenError, UsageError
from obpose.scenes.infer import fit_to_frames
from obpose.scenes.refine import STEPS
from obpose.scenes.rendering import Renderer
from obpose.viewer.latest_worker import LatestWorker
from obpose.viewer.panel import MOST_SAMPLED, Commands, Panel
from obpose.viewer.rendering import Chunk, Clouds, Picture, Progress, ProgressiveRenderer, RenderRequest, Shape
from obpose.viewer.scene3d import Scene3D
from obpose.viewer.scene_io import OpenedScene, Sampler, save_new
from obpose.viewer.server import close_server
from obpose.viewer.session import Session

_SECONDS = 8.0
"""Seconds a notification stays visible."""


class Page:
    """The page of one server."""

    def __init__(
        self,
        server: viser.ViserServer,
        opened: OpenedScene,
        out: Path,
        *,
        preview: int = 64,
        final: int = 256,
        fit_steps: int = STEPS,
    ):
        """Build the page.

        `preview` and `final` are the longer sides of the first picture after a change and of the last, pixels. Fits to
        the frames take `fit_steps` steps. Saved scenes get a new folder each in `out`.
        """
        self.title = opened.title
        self.server, self._opened, self._out, self._fit_steps = server, opened, out, fit_steps
        self._lock = threading.RLock()
        self.session = Session(opened.scene, opened.origin.model, opened.title)
        self._renderer, self._sampler = Renderer(opened.origin.model), Sampler(opened.origin)
        commands = Commands(self.edit, self.fit, self.sample, self.save)
        self.panel = Panel(server, self.session, commands, str(out), can_fit=opened.is_inferred)
        self._scene3d = Scene3D(server, opened.origin.model, opened.scene, self.edit)
        self._input_frame: int | None = None
        self._note = ""
        self._requested: tuple | None = None
        progressive = ProgressiveRenderer(self._renderer, opened.scene, opened.clip, preview=preview, final=final)
        self.worker = LatestWorker(progressive.render, self._deliver, self._on_error)
        self._refresh()

    def close(self) -> None:
        """Stop rendering and disconnect all browsers."""
        self.worker.close()
        close_server(self.server)

    def edit(self, change: Callable[[Session], None]) -> None:
        """Change the session and show the result; the edit may fail because of another window's edit."""
        with self._lock:
            try:
                change(self.session)
            except UsageError as error:
                self._notify("Not possible", str(error), "red")
            self._refresh()

    def fit(self) -> None:
        """Fit the inferred scene to its frames; edited scenes no longer match them."""
        scene, clip = self._opened.scene, self._opened.clip

        def check_unedited(session: Session) -> None:
            if session.scene is not scene:
                raise UsageError("The scene was edited and no longer matches its frames; undo the edits to fit it.")

        def job() -> None:
            assert clip is not None
            with self._lock:
                check_unedited(self.session)
            fitted = fit_to_frames(scene, self._opened.origin.model, clip, refinements=self._fit_steps)

            def change(session: Session) -> None:
                check_unedited(session)
                session.fit(fitted)

            self.edit(change)

        self._run("Fitting to the frames, for some seconds", job)

    def sample(self, objects: str) -> None:
        """Sample a scene; the number of objects comes from the page, which may send any text."""
        if objects not in map(str, range(MOST_SAMPLED + 1)):
            expected = f"expected a whole number from 0 to {MOST_SAMPLED}"
            self._notify("Not possible", f"New objects: {objects!r:.20}; {expected}.", "red")
            return
        count = int(objects)

        def job() -> None:
            scene = self._sampler.next(count, self._opened.scene.cameras)
            title = f"sampled with seed {self._sampler.seed}"
            self.edit(lambda session: session.replace(scene, title))
            self._notify("Sampled", f"{counted(count, 'object')}, with seed {self._sampler.seed}")

        self._run("Sampling a new scene", job)

    def save(self) -> None:
        """Save the scene as it is now, regardless of edits before the job runs."""
        with self._lock:
            scene = self.session.scene

        def job() -> None:
            folder = save_new(self._out, scene, self._renderer)
            content = f"{counted(scene.frames, 'frame')}, {counted(len(scene.ids), 'object')}"
            self._notify("Saved", f"{folder}: {content}", "green")

        self._run("Saving", job)

    def _run(self, name: str, job: Callable[[], None]) -> None:
        """Run a job in the worker thread, and show its name on the page until it is done."""
        with self._lock:
            self.panel.begin_job(name)

        def job_with_indicator() -> None:
            try:
                job()
            finally:
                with self._lock:
                    self.panel.end_job(name)

        self.worker.run(job_with_indicator)

    def _refresh(self) -> None:
        """Show the current session and request the renderings it needs."""
        session, clip = self.session, self._opened.clip
        self._scene3d.show(session, self.panel.layers)
        self.panel.show(session)
        if clip is not None and session.frame != self._input_frame:
            self._scene3d.put_inputs(clip.rgb[0, session.frame])
            self._input_frame = session.frame
        needed = session.version, session.frame, session.view
        if needed != self._requested:
            self._requested = needed
            self.worker.request(RenderRequest(session.shown, session.frame, session.view, time.monotonic()))

    def _deliver(self, request: RenderRequest, chunk: Chunk) -> None:
        with self._lock:
            match chunk:
                case Picture():
                    self._show_picture(request, chunk)
                case Shape():
                    self._scene3d.put_shape(chunk.name, chunk.mesh)
                case Clouds():
                    self._scene3d.put_clouds(chunk.clouds)
                case Progress():
                    self.panel.show_progress(f"{self._note}; rendering a larger picture ...", chunk.share)
            if not isinstance(chunk, Progress):
                self._scene3d.show(self.session, self.panel.layers)

    def _show_picture(self, request: RenderRequest, chunk: Picture) -> None:
        clip, observed = self._opened.clip, None
        if clip is not None and self.session.version.sources is not None:
            observed = clip.rgb[0, request.frame, request.view], clip.depth[0, request.frame, request.view]
        height, width = chunk.image.depth.shape
        self._note = f"{width}x{height}, {time.monotonic() - request.since:.2f} s after the last change"
        self.panel.show_picture(chunk.image, observed)
        self.panel.show_progress(self._note, 0.0 if chunk.is_preview else 1.0)

    def _on_error(self, error: Exception) -> None:
        if isinstance(error, DatagenError | OSError):
            self._notify("Not possible", str(error), "red")
        else:
            # A bug: print the traceback in the terminal, and keep the page alive so that no edits are lost.
            traceback.print_exception(error, file=sys.stderr)
            self._notify("Something is wrong in the viewer itself", f"{type(error).__name__}: {error}", "red")

    def _notify(self, title: str, text: str, color: Literal["red", "green"] | None = None) -> None:
        for client in self.server.get_clients().values():
            client.add_notification(title, text, auto_close_seconds=_SECONDS, color=color)
