"""Editing session: a scene, its earlier versions and the current selection, independent of the page."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.model.obpose import ObPose
from obpose.scenes import edit
from obpose.scenes.bounds import workspace_bounds
from obpose.scenes.scene import Scene

_MOST_VERSIONS = 1000
"""Largest number of edits that can be undone."""
_DIRECTIONS, _ASIDE = 8, 0.75
"""Placement of copies: number of candidate directions, and distance in box edges."""


@dataclass(frozen=True, eq=False)
class Version:
    """A scene, the sources of its objects, and the hidden ones."""

    scene: Scene
    sources: Mapping[int, int] | None
    """For each object, the inferred object that it is or was copied from; None if the scene has no input."""
    unedited: Scene
    """Scene before all edits. In versions that share it, equal names mean the same object."""
    title: str = ""
    """Source of the scene: dataset, saved scene or sample, as shown in the title."""
    hidden: frozenset[int] = frozenset()


class Session:
    """Step-by-step editing of one scene; not thread-safe."""

    def __init__(self, scene: Scene, model: ObPose, title: str = ""):
        """Start a session; the model determines the workspace bounds and the box size."""
        self.version = Version(scene, {name: name for name in scene.ids}, unedited=scene, title=title)
        self.selected: int | None = None
        self.frame = 0
        self.view = 0
        self._past: deque[Version] = deque(maxlen=_MOST_VERSIONS)
        self._grabbed: Version | None = None
        self._low, self._high = workspace_bounds(model)
        self._box = model.config.model.pose.box_size

    @property
    def scene(self) -> Scene:
        """Current scene, including hidden objects."""
        return self.version.scene

    @property
    def hidden(self) -> frozenset[int]:
        """Names of the hidden objects."""
        return self.version.hidden

    @property
    def shown(self) -> Scene:
        """Current scene without the hidden objects."""
        shown = self.scene
        for name in self.hidden:
            shown = edit.remove(shown, name)
        return shown

    @property
    def can_undo(self) -> bool:
        """Whether there is an edit to undo."""
        return bool(self._past)

    @property
    def is_dragging(self) -> bool:
        """Whether an object is being dragged."""
        return self._grabbed is not None

    def select(self, name: int | None) -> None:
        """Select an object for dragging; None to select nothing."""
        if name is not None:
            self.scene.place(name)
        self.drop()
        self.selected = name

    def toggle(self, name: int) -> None:
        """Select an object, or release it if it is selected."""
        self.select(None if self.selected == name else name)

    def go_to_frame(self, frame: int) -> None:
        """Show another frame; a drag in progress ends."""
        if frame != self.frame:
            self.drop()
            self.frame = min(max(frame, 0), self.scene.frames - 1)

    def go_to_view(self, view: int) -> None:
        """Render from another of the scene's cameras."""
        self.view = min(max(view, 0), len(self.scene.cameras) - 1)

    def hide(self, name: int) -> None:
        """Hide an object; it stays in the scene, and hiding cannot be undone as an edit."""
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
        """Remove an object from the scene."""
        self._become(replace(self.version, scene=edit.remove(self.scene, name), hidden=self.hidden - {name}))

    def duplicate(self, name: int) -> None:
        """Put a copy beside an object, on the side with the most room, and select it."""
        copied = edit.duplicate(self.scene, name, self._beside(name))
        sources = self.version.sources
        if sources is not None and name in sources:
            sources = {**sources, copied.ids[-1]: sources[name]}
        self._become(replace(self.version, scene=copied, sources=sources))
        self.select(copied.ids[-1])

    def grab(self) -> None:
        """Start dragging the selected object; all changes until `drop` are one edit."""
        self.drop()
        if self.selected is not None:
            self._grabbed = self.version

    def drag(self, to: Float[Tensor, "3"], turn: Float[Tensor, "3 3"]) -> None:
        """Move the dragged object, within the workspace, and rotate it.

        `to` is the new centre of its box in the current frame, metres. `turn` is relative to its orientation when it
        was grabbed. Both are in the world frame.
        """
        if self._grabbed is None or self.selected is None:
            return
        scene, name = self._grabbed.scene, self.selected
        by = self._within(scene, name, to - scene.center[self.frame, scene.place(name)])
        moved = edit.rotate(edit.move(scene, name, by), name, turn)
        self.version = replace(self._grabbed, scene=moved)

    def drop(self) -> None:
        """End the drag of an object."""
        if self._grabbed is not None and self._grabbed is not self.version:
            self._past.append(self._grabbed)
        self._grabbed = None

    def replace(self, scene: Scene, title: str = "") -> None:
        """Switch to another scene of the same model, without input."""
        self._become(Version(scene, None, unedited=scene, title=title))
        self.selected = None

    def fit(self, scene: Scene) -> None:
        """Replace the scene by a version fitted to the input, with the same objects in the same places."""
        self._become(replace(self.version, scene=scene))

    def undo(self) -> None:
        """Undo the last edit, if any; a drag in progress counts as one. Hidden objects stay hidden."""
        self.drop()
        if self._past:
            past = self._past.pop()
            if past.unedited is self.version.unedited:
                gone = frozenset(past.scene.ids) - frozenset(self.scene.ids)
                past = replace(past, hidden=(past.hidden & gone) | (self.hidden & frozenset(past.scene.ids)))
            self.version = past
            self._settle()

    def _become(self, version: Version) -> None:
        """Switch to another version; a drag in progress ends first, as a separate edit."""
        self.drop()
        self._past.append(self.version)
        self.version = version
        self._settle()

    def _settle(self) -> None:
        """Reset a selection, frame or view that no longer exists."""
        self.selected = self.selected if self.selected in self.scene.ids else None
        self.frame = min(self.frame, self.scene.frames - 1)
        self.view = min(self.view, len(self.scene.cameras) - 1)

    def _within(self, scene: Scene, name: int, by: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
        """Clamp a displacement so that an object stays inside the workspace in all frames."""
        center = scene.center[:, scene.place(name)]
        return by.clamp(self._low - center.amin(dim=0), self._high - center.amax(dim=0))

    def _beside(self, name: int) -> Float[Tensor, "3"]:
        """Displacement of a copy, in the direction with the most distance to the nearest object in this frame."""
        angles = torch.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
        steps = torch.stack([angles.cos(), angles.sin(), torch.zeros(_DIRECTIONS)], dim=-1) * (_ASIDE * self._box)
        center = self.scene.center[self.frame]
        places = center[self.scene.place(name)] + steps
        nearest = torch.cdist(places, center).amin(dim=1)
        return self._within(self.scene, name, steps[nearest.argmax()])
