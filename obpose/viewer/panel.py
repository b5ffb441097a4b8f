"""The controls beside the scene: rendered pictures, objects, actions and layers, as widgets of viser."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from html import escape

import numpy as np
import torch
import viser
from jaxtyping import Float
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont
from torch import Tensor

from obpose.pictures import Picture, to_bytes
from obpose.scenes.rendering import Image
from obpose.viewer.point_clouds import slot_colour
from obpose.viewer.scene3d import DRAWN_AS, Layers
from obpose.viewer.session import Session

MOST_SAMPLED = 8
"""Largest number of objects of a sampled scene."""
_COUNTS = tuple(str(count) for count in range(MOST_SAMPLED + 1))
_MOVE, _HIDE, _SHOW, _COPY, _REMOVE = "move", "hide", "show", "copy", "remove"
TILE, TITLE, _GAP = 256, 26, 6
"""Width of a picture, height of its title, and width of the gap between pictures, pixels."""

Observed = tuple[Float[Tensor, "h w 3"], Float[Tensor, "h w"]]
"""Colours and depth of one view of the input; metres, 0 = missing."""


@dataclass(frozen=True)
class Commands:
    """Callbacks of the controls."""

    edit: Callable[[Callable[[Session], None]], None]
    """Function called with a change of the session."""
    fit: Callable[[], None]
    sample: Callable[[str], None]
    """Function called with the number of objects, as text."""
    save: Callable[[], None]


@dataclass
class _Row:
    title: viser.GuiHtmlHandle
    buttons: viser.GuiButtonGroupHandle


class Panel:
    """The widgets of one page."""

    def __init__(self, server: viser.ViserServer, session: Session, commands: Commands, out: str, *, can_fit: bool):
        self._gui, self._commands = server.gui, commands
        self._gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self._gui.main_panel.dock_right()
        self._rows: dict[int, _Row] = {}
        self._title = ""
        self._note, self._jobs = "", list[str]()
        self._unedited, self._is_unedited = session.scene, True
        self._shown: tuple[Image, Observed | None] | None = None
        self._window_title = self._gui.add_html("")
        self._picture = self._gui.add_image(np.full((TITLE + TILE, 2 * TILE + _GAP, 3), 238, np.uint8), format="png")
        self._status = self._gui.add_html(_small("rendering ..."))
        self._bar = self._gui.add_progress_bar(0)
        self._add_time_and_view(session)
        self._objects = self._gui.add_folder("Objects")
        self._add_scene(out, can_fit)
        self._add_layers()

    @property
    def layers(self) -> Layers:
        """Layers chosen for the 3D scene."""
        return Layers(self._drawn_as.value, self._boxes.value, self._cameras.value)

    @property
    def is_busy(self) -> bool:
        """Whether a job is running."""
        return bool(self._jobs)

    def begin_job(self, name: str) -> None:
        """Show a running job and disable the buttons of jobs, until `end_job` is called with this name."""
        self._jobs.append(name)
        self._show_jobs()

    def end_job(self, name: str) -> None:
        """Remove a finished job from the display."""
        self._jobs.remove(name)
        self._show_jobs()

    def show(self, session: Session) -> None:
        """Update the widgets to the session."""
        self._show_title(session.version.title)
        for name in self._rows.keys() - set(session.scene.ids):
            row = self._rows.pop(name)
            row.title.remove()
            row.buttons.remove()
        for name in session.scene.ids:
            self._show_row(session, name)
        frames = session.scene.frames
        self._frame.visible = frames > 1
        self._frame.max = max(1, frames - 1)
        self._frame.value = session.frame
        self._view.value = _view_name(session.view)
        self._undo.disabled = not session.can_undo
        self._is_unedited = session.scene is self._unedited
        self._enable_jobs()

    def show_picture(self, image: Image, observed: Observed | None) -> None:
        """Show a rendered picture beside the input, if there is one."""
        self._shown = image, observed
        self._picture.image = compose(image, observed, with_depth=self._depth.value)

    def show_progress(self, note: str, share: float) -> None:
        """Show a line of text and the finished share of the rendering."""
        self._note = note
        if not self.is_busy:
            self._status.content = _small(note)
            self._bar.value = 100 * share if share < 1 else 0

    def _show_jobs(self) -> None:
        self._status.content = _small(f"{self._jobs[0]} ..." if self._jobs else self._note)
        self._bar.value, self._bar.animated = (100, True) if self._jobs else (0, False)
        self._enable_jobs()

    def _enable_jobs(self) -> None:
        self._save.disabled = self._sample.disabled = self.is_busy
        self._fit.disabled = self.is_busy or not self._is_unedited

    def _show_title(self, title: str) -> None:
        if title != self._title:
            self._title = title
            self._gui.set_panel_label(title)
            # viser cannot change the title of the window. The error handler of an invalid image can.
            script = f"document.title = {json.dumps(f'{title} - obpose-view')}"
            self._window_title.content = f'<img src="data:," hidden onerror="{escape(script)}">'

    def _show_row(self, session: Session, name: int) -> None:
        row = self._rows.get(name) or self._add_row(name)
        selected, hidden = session.selected == name, name in session.hidden
        row.title.content = _title(name, "hidden" if hidden else "held" if selected else "")
        options = (_MOVE, _SHOW if hidden else _HIDE, _COPY, _REMOVE)
        if row.buttons.options != options:
            row.buttons.options = options

    def _add_row(self, name: int) -> _Row:
        with self._objects:
            title = self._gui.add_html("", order=name)
            buttons = self._gui.add_button_group("", (_MOVE, _HIDE, _COPY, _REMOVE), order=name + 0.5)
        changes: dict[str, Callable[[Session, int], None]] = {
            _MOVE: Session.toggle,
            _HIDE: Session.hide,
            _SHOW: Session.unhide,
            _COPY: Session.duplicate,
            _REMOVE: Session.remove,
        }

        def click(label: str) -> None:
            if change := changes.get(label):  # a page may send any text
                self._commands.edit(lambda session: change(session, name))

        buttons.on_click(lambda event: click(event.target.value))
        self._rows[name] = _Row(title, buttons)
        return self._rows[name]

    def _add_time_and_view(self, session: Session) -> None:
        edit = self._commands.edit
        self._frame = self._gui.add_slider("Frame", min=0, max=1, step=1, initial_value=0)
        self._frame.on_update(lambda event: edit(lambda session: session.go_to_frame(int(event.target.value))))
        views = {_view_name(view): view for view in range(len(session.scene.cameras))}
        self._view = self._gui.add_dropdown("View", list(views), visible=len(views) > 1)
        self._view.on_update(
            lambda event: edit(lambda session: session.go_to_view(views.get(event.target.value, session.view)))
        )

    def _add_scene(self, out: str, can_fit: bool) -> None:
        gui, commands = self._gui, self._commands
        with gui.add_folder("Scene"):
            hint = "Takes some seconds; possible before any edit"
            self._fit = gui.add_button("Fit to the frames", icon=viser.Icon.FOCUS_2, hint=hint, visible=can_fit)
            self._undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP)
            self._save = gui.add_button("Save", icon=viser.Icon.DEVICE_FLOPPY, hint=f"Into a new folder in {out}")
            # Not a number field: text that is no number would end the connection.
            count = gui.add_dropdown("New objects", _COUNTS, initial_value=_COUNTS[4])
            self._sample = gui.add_button("Sample a new scene", icon=viser.Icon.DICE_5)
        self._fit.on_click(lambda _: commands.fit())
        self._undo.on_click(lambda _: commands.edit(Session.undo))
        self._save.on_click(lambda _: commands.save())
        self._sample.on_click(lambda _: commands.sample(count.value))

    def _add_layers(self) -> None:
        with self._gui.add_folder("Show", expand_by_default=False):
            self._drawn_as = self._gui.add_dropdown("Objects as", DRAWN_AS)
            self._boxes, self._cameras = (self._gui.add_checkbox(label, True) for label in ("Boxes", "Cameras"))
            self._depth = self._gui.add_checkbox("Depth", False, hint="Adds depth to the pictures above")
        for widget in (self._drawn_as, self._boxes, self._cameras):
            # Redraws the page.
            widget.on_update(lambda _: self._commands.edit(lambda _session: None))
        self._depth.on_update(lambda _: self._commands.edit(lambda _session: self._show_again()))

    def _show_again(self) -> None:
        if self._shown:
            self.show_picture(*self._shown)


def compose(image: Image, observed: Observed | None, *, with_depth: bool) -> Picture:
    """Place the rendered picture beside the input, or beside its own depth if there is no input.

    `with_depth` adds a row with the depths of input and scene, in the same greys.
    """
    seen = image.depth if observed is None else observed[1]
    known = seen[seen > 0]
    reach = (float(known.min()), float(known.max())) if known.numel() else (0.0, 1.0)
    depth = greys(image.depth, reach)
    if observed is None:
        return _row({"scene": image.rgb, "depth": depth})
    colours = _row({"input": observed[0], "scene": image.rgb})
    if not with_depth:
        return colours
    return np.concatenate([colours, _row({"input depth": greys(observed[1], reach), "scene depth": depth})])


def greys(depth: Float[Tensor, "h w"], reach: tuple[float, float]) -> Float[Tensor, "h w 3"]:
    """Depth as grey values: near is white, far is dark, missing is black; metres."""
    near, far = reach
    grey = 0.1 + 0.9 * ((far - depth) / max(far - near, 1e-6)).clamp(0, 1)
    return torch.where(depth > 0, grey, 0.0)[..., None].expand(*depth.shape, 3)


def _row(pictures: dict[str, Float[Tensor, "..."]]) -> Picture:
    """Two pictures of equal size on white, enlarged or reduced to the width of tiles, below their titles."""
    tiles = [_tile(to_bytes(colours)) for colours in pictures.values()]
    canvas = Pillow.new("RGB", (2 * TILE + _GAP, TITLE + max(tile.height for tile in tiles)), (255, 255, 255))
    for left, title, tile in zip((0, TILE + _GAP), pictures, tiles, strict=True):
        ImageDraw.Draw(canvas).text((left + 2, 0), title, fill=(60, 60, 60), font=ImageFont.load_default(19))
        canvas.paste(tile, (left, TITLE))
    return np.asarray(canvas)


def _tile(pixels: Picture) -> Pillow.Image:
    """Resize to the width of tiles; small images keep their pixels visible."""
    height, width = pixels.shape[:2]
    method = Pillow.Resampling.NEAREST if width < TILE else Pillow.Resampling.BOX
    return Pillow.fromarray(pixels).resize((TILE, max(1, round(height * TILE / width))), method)


def _view_name(view: int) -> str:
    return f"camera {view + 1}"


def _title(name: int, note: str) -> str:
    colour = "rgb({}, {}, {})".format(*slot_colour(name))
    dot = f'<span style="color: {colour}">&#9679;</span>'
    # Without a height of its own, so that it takes the place of the missing label of the row of buttons.
    return f'<div style="height: 0; padding-left: 0.8em; font-size: 0.85em">{dot} {name} <i>{note}</i></div>'


def _small(text: str) -> str:
    return f'<div style="padding: 0 0.9em; font-size: 0.8em; opacity: 0.75">{escape(text)}</div>'
