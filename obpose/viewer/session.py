"""What is being edited: a scene, the versions before it, and what of it is looked at. It knows nothing of the page."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.creation import edit
from obpose.creation.bounds import workspace_bounds
from obpose.creation.scene import Scene
from obpose.model import ObPose

_MOST_VERSIONS = 1000
"""Edits that can be undone."""
_DIRECTIONS, _ASIDE = 8, 0.75
"""Where copies are put: in one of so many directions, so many edges of a box away."""


@dataclass(frozen=True, eq=False)
class Version:
    """A scene, where its objects come from, and which of them are hidden."""

    scene: Scene
    seen_as: Mapping[int, int] | None
    """Which object of the input each is, or a copy of; None where the scene is not that of the input."""
    began: Scene
    """What it was before all edits: of equal beginnings, equal names are the same object."""
    title: str = ""
    """Where the scene comes from."""
    hidden: frozenset[int] = frozenset()


class Session:
    """One scene that is edited step by step; not for several threads at once."""

    def __init__(self, scene: Scene, model: ObPose, title: str = ""):
        """The model says where objects can be and how large they are."""
        self.version = Version(scene, {name: name for name in scene.ids}, began=scene, title=title)
        self.selected: int | None = None
        self.frame = 0
        self.view = 0
        self._past: deque[Version] = deque(maxlen=_MOST_VERSIONS)
        self._grabbed: Version | None = None
        self._low, self._high = workspace_bounds(model)
        self._box = model.config.model.pose.box_size

    @property
    def scene(self) -> Scene:
        """As it is now, hidden objects included."""
        return self.version.scene

    @property
    def hidden(self) -> frozenset[int]:
        """Objects that are not shown."""
        return self.version.hidden

    @property
    def shown(self) -> Scene:
        """Without the hidden objects."""
        shown = self.scene
        for name in self.hidden:
            shown = edit.remove(shown, name)
        return shown

    @property
    def can_undo(self) -> bool:
        """Whether anything was edited."""
        return bool(self._past)

    @property
    def is_dragging(self) -> bool:
        """Whether an object is held."""
        return self._grabbed is not None

    def select(self, name: int | None) -> None:
        """Choose the object that is dragged."""
        if name is not None:
            self.scene.place(name)
        self.drop()
        self.selected = name

    def go_to_frame(self, frame: int) -> None:
        """Look at another moment; an object that is held is let go of."""
        self.drop()
        self.frame = min(max(frame, 0), self.scene.frames - 1)

    def look(self, view: int) -> None:
        """Render from another of the scene's cameras."""
        self.view = min(max(view, 0), len(self.scene.cameras) - 1)

    def hide(self, name: int) -> None:
        """Leave an object out of what is shown; it stays in the scene, and this is no edit to undo."""
        self.scene.place(name)
        self.drop()
        self.version = replace(self.version, hidden=self.hidden | {name})
        if self.selected == name:
            self.select(None)

    def unhide(self, name: int) -> None:
        """Show an object again."""
        self.drop()
        self.version = replace(self.version, hidden=self.hidden - {name})

    def remove(self, name: int) -> None:
        """Take an object out of the scene."""
        self._become(replace(self.version, scene=edit.remove(self.scene, name), hidden=self.hidden - {name}))

    def duplicate(self, name: int) -> None:
        """Put a copy beside an object, where most room is, and select it."""
        copied = edit.duplicate(self.scene, name, self._beside(name))
        seen_as = self.version.seen_as
        if seen_as is not None and name in seen_as:
            seen_as = {**seen_as, copied.ids[-1]: seen_as[name]}
        self._become(replace(self.version, scene=copied, seen_as=seen_as))
        self.select(copied.ids[-1])

    def grab(self) -> None:
        """Take hold of the selected object: what follows until `drop` is one edit."""
        self.drop()
        if self.selected is not None:
            self._grabbed = self.version

    def drag(self, to: Float[Tensor, "3"], turn: Float[Tensor, "3 3"]) -> None:
        """Move the middle of the held object there in this frame, as far as the workspace reaches, and turn it.

        Args:
            to: World frame, metres.
            turn: Rotation of the world, relative to how the object was when it was grabbed.
        """
        if self._grabbed is None or self.selected is None:
            return
        scene, name = self._grabbed.scene, self.selected
        by = self._within(scene, name, to - scene.center[self.frame, scene.place(name)])
        moved = edit.rotate(edit.move(scene, name, by), name, turn)
        self.version = replace(self._grabbed, scene=moved)

    def drop(self) -> None:
        """Let go of the held object."""
        if self._grabbed is not None and self._grabbed is not self.version:
            self._past.append(self._grabbed)
        self._grabbed = None

    def replace(self, scene: Scene, title: str = "") -> None:
        """Go on with another scene of the same model, which is not that of the input."""
        self._become(Version(scene, None, began=scene, title=title))
        self.selected = None

    def fit(self, scene: Scene) -> None:
        """Go on with the same objects in the same places, only that they look more like the input."""
        self._become(replace(self.version, scene=scene))

    def undo(self) -> None:
        """Go back to before the last edit, if there was one, as is a drag that goes on; what is hidden stays so."""
        self.drop()
        if self._past:
            past = self._past.pop()
            if past.began is self.version.began:
                gone = frozenset(past.scene.ids) - frozenset(self.scene.ids)
                past = replace(past, hidden=(past.hidden & gone) | (self.hidden & frozenset(past.scene.ids)))
            self.version = past
            self._settle()

    def _become(self, version: Version) -> None:
        """Go on with another version; a drag that goes on ends before, as an edit of its own."""
        self.drop()
        self._past.append(self.version)
        self.version = version
        self._settle()

    def _settle(self) -> None:
        """Let go of objects, frames and views that are no more."""
        self.selected = self.selected if self.selected in self.scene.ids else None
        self.frame = min(self.frame, self.scene.frames - 1)
        self.view = min(self.view, len(self.scene.cameras) - 1)

    def _within(self, scene: Scene, name: int, by: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
        """As much of a displacement as leaves an object of a scene inside the workspace in all frames."""
        center = scene.center[:, scene.place(name)]
        return by.clamp(self._low - center.amin(dim=0), self._high - center.amax(dim=0))

    def _beside(self, name: int) -> Float[Tensor, "3"]:
        """Beside the object's box, in the direction in which the nearest object is farthest in this frame."""
        angles = torch.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
        steps = torch.stack([angles.cos(), angles.sin(), torch.zeros(_DIRECTIONS)], dim=-1) * (_ASIDE * self._box)
        center = self.scene.center[self.frame]
        places = center[self.scene.place(name)] + steps
        nearest = torch.cdist(places, center).amin(dim=1)
        return self._within(self.scene, name, steps[nearest.argmax()])
