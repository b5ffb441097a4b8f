"""The controls beside the scene, as widgets of viser."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser

from obpose.viewer.point_clouds import slot_colour
from obpose.viewer.sampling import COUNTS
from obpose.viewer.scene3d import POINTS, Layers
from obpose.viewer.session import Session

_MOVE, _HIDE, _SHOW, _COPY, _REMOVE = "move", "hide", "show", "copy", "remove"


@dataclass(frozen=True)
class Actions:
    """Callbacks of the controls."""

    select: Callable[[int | None], None]
    hide: Callable[[int], None]
    unhide: Callable[[int], None]
    duplicate: Callable[[int], None]
    remove: Callable[[int], None]
    go_to_frame: Callable[[int], None]
    look: Callable[[int], None]
    draw: Callable[[], None]
    """Called when the choice of layers changes."""
    undo: Callable[[], None]
    fit: Callable[[], None]
    sample: Callable[[str], None]
    """Called with the number of objects, as text."""
    save: Callable[[], None]


@dataclass
class _Row:
    title: viser.GuiHtmlHandle
    buttons: viser.GuiButtonGroupHandle


class Panel:
    """The widgets of one page."""

    def __init__(self, server: viser.ViserServer, session: Session, actions: Actions, out: str, *, can_fit: bool):
        self._gui, self._actions = server.gui, actions
        self._gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self._gui.main_panel.dock_right()
        self._rows: dict[int, _Row] = {}
        self._title = ""
        self._busy = self._gui.add_html("", visible=False)
        self._running = self._gui.add_progress_bar(100, animated=True, visible=False)
        self._picture = self._gui.add_image(np.full((24, 32, 3), 238, np.uint8), format="png")
        self._note = self._gui.add_html(_small("rendering ..."))
        self._frame, self._view = self._add_time_and_view(session)
        self._objects = self._gui.add_folder("Objects")
        self._undo, self._fit, self._jobs = self._add_scene(out, can_fit)
        self._doing: list[str] = []
        self._as_inferred = session.scene
        self._can_fit_now = True
        self._points, self._shapes, self._boxes, self._cameras = self._add_layers()

    @property
    def layers(self) -> Layers:
        """Layers chosen for drawing."""
        values = self._shapes.value, self._boxes.value, self._cameras.value
        return Layers(self._points.value, *values)

    def begin(self, doing: str) -> None:
        """Show a running job and disable the buttons of jobs, until `end` is called with the same text."""
        self._doing.append(doing)
        self._show_busy()

    def end(self, doing: str) -> None:
        """Remove a finished job from the display."""
        self._doing.remove(doing)
        self._show_busy()

    def _show_busy(self) -> None:
        busy = bool(self._doing)
        self._busy.content = _small(f"{self._doing[0]} ..." if busy else "")
        self._busy.visible = self._running.visible = busy
        for button in self._jobs:
            button.disabled = busy
        self._fit.disabled = busy or not self._can_fit_now

    def show(self, session: Session) -> None:
        """Update the widgets to the session."""
        if session.version.title != self._title:
            self._title = session.version.title
            self._gui.set_panel_label(self._title)
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
        self._can_fit_now = session.scene is self._as_inferred
        self._fit.disabled = bool(self._doing) or not self._can_fit_now

    def put_picture(self, picture: np.ndarray, note: str) -> None:
        """Show a rendered picture with a line of text."""
        self._picture.image = picture
        self._note.content = _small(note)

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
        actions = {
            _MOVE: self._actions.select,
            _HIDE: self._actions.hide,
            _SHOW: self._actions.unhide,
            _COPY: self._actions.duplicate,
            _REMOVE: self._actions.remove,
        }
        buttons.on_click(lambda event: actions.get(event.target.value, _nothing)(name))
        self._rows[name] = _Row(title, buttons)
        return self._rows[name]

    def _add_time_and_view(self, session: Session) -> tuple[viser.GuiSliderHandle[int], viser.GuiDropdownHandle[str]]:
        frame = self._gui.add_slider("Frame", min=0, max=1, step=1, initial_value=0)
        frame.on_update(lambda event: self._actions.go_to_frame(int(event.target.value)))
        names = [_view_name(view) for view in range(len(session.scene.cameras))]
        view = self._gui.add_dropdown("View", names, visible=len(names) > 1)
        places = {name: place for place, name in enumerate(names)}
        view.on_update(lambda event: self._actions.look(places.get(event.target.value, session.view)))
        return frame, view

    def _add_scene(
        self, out: str, can_fit: bool
    ) -> tuple[viser.GuiButtonHandle, viser.GuiButtonHandle, tuple[viser.GuiButtonHandle, ...]]:
        """Add the scene controls; give the buttons to undo, to fit, and those of other jobs."""
        with self._gui.add_folder("Scene"):
            fit = self._gui.add_button(
                "Fit to the frames",
                icon=viser.Icon.FOCUS_2,
                hint="Takes some seconds, before any edit",
                visible=can_fit,
            )
            undo = self._gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP)
            save = self._gui.add_button("Save", icon=viser.Icon.DEVICE_FLOPPY, hint=f"Into a new folder in {out}")
            # No field for numbers: whatever cannot be read as one would end the connection.
            count = self._gui.add_dropdown("New objects", COUNTS, initial_value=COUNTS[4])
            sample = self._gui.add_button("Sample a new scene", icon=viser.Icon.DICE_5)
        fit.on_click(lambda _: self._actions.fit())
        undo.on_click(lambda _: self._actions.undo())
        save.on_click(lambda _: self._actions.save())
        sample.on_click(lambda _: self._actions.sample(count.value))
        return undo, fit, (save, sample)

    def _add_layers(self) -> tuple:
        with self._gui.add_folder("Show", expand_by_default=False):
            points = self._gui.add_dropdown("Points", POINTS)
            boxes = [self._gui.add_checkbox(label, initial_value=True) for label in ("Shapes", "Boxes", "Cameras")]
        for widget in (points, *boxes):
            widget.on_update(lambda _: self._actions.draw())
        return points, *boxes


def _nothing(_name: int) -> None:
    """Do nothing; stands in for a missing button."""


def _view_name(view: int) -> str:
    return f"camera {view + 1}"


def _title(name: int, note: str) -> str:
    colour = "rgb({}, {}, {})".format(*slot_colour(name))
    dot = f'<span style="color: {colour}">&#9679;</span>'
    # Without a height of its own, to stand in the place of the label that the row of buttons does not have.
    return f'<div style="height: 0; padding-left: 0.8em; font-size: 0.85em">{dot} {name} <i>{note}</i></div>'


def _small(text: str) -> str:
    return f'<div style="padding: 0 0.9em; font-size: 0.8em; opacity: 0.75">{text}</div>'
