"""Models whose objects have poses (`obpose.scenes`), as editors of scenes."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Integer

from benchmark.models.editor_interface import Picture
from benchmark.models.interface import Clip
from datagen.schema import EditKind
from obpose.data.clips import ArrayClips, observation_of
from obpose.scenes import edit
from obpose.scenes.infer import Inferred, infer_labelled
from obpose.scenes.model_ref import load_origin
from obpose.scenes.rendering import Image, Renderer
from obpose.scenes.scene import Scene
from obpose.training.devices import keep_memory


class SceneEditor:
    """A model from a checkpoint; implements `benchmark.models.editor_interface.Editor`."""

    def __init__(self, checkpoint: Path, *, refinements: int = 0):
        """Load a model; `refinements` is the number of steps that fit inferred scenes to their frames."""
        torch.set_num_threads(1)
        keep_memory()
        self._refinements = refinements
        self._origin = load_origin(str(checkpoint))

    def infer(self, clip: Clip) -> "InferredScene":
        """Infer the scene of a clip."""
        source = ArrayClips([clip])
        observation = observation_of([source.window(0, 0, source.frames_of_clip)])
        inferred = infer_labelled(self._origin, observation, refinements=self._refinements)
        return InferredScene(inferred, Renderer(self._origin.model))


class InferredScene:
    """Scene inferred from a clip; implements `benchmark.models.editor_interface.EditableScene`."""

    def __init__(self, inferred: Inferred, renderer: Renderer):
        self._scene, self._renderer = inferred.scene, renderer
        self.labels: Integer[np.ndarray, "frame seen height width"] = inferred.labels.numpy()

    def render(self, frames: Sequence[int]) -> Picture:
        """Render all views of the unedited scene."""
        return self._picture(self._scene, frames)

    def edited(self, kind: EditKind, label: int, transform: Float[np.ndarray, "4 4"], frames: Sequence[int]) -> Picture:
        """Render all views after an edit of one object."""
        return self._picture(_EDITS[kind](self._scene, label, torch.from_numpy(transform).float()), frames)

    def _picture(self, scene: Scene, frames: Sequence[int]) -> Picture:
        images = [[self._renderer.render(scene, frame, camera) for camera in scene.cameras] for frame in frames]
        names = np.array([0, *scene.ids])
        return Picture(_stacked(images, "rgb"), _stacked(images, "depth"), names[_stacked(images, "nearest")])


def _stacked(images: list[list[Image]], name: str) -> np.ndarray:
    return np.array([[getattr(image, name).numpy() for image in views] for views in images])


def _with_carried_copy(scene: Scene, name: int, transform: torch.Tensor) -> Scene:
    copied = edit.duplicate(scene, name, torch.zeros(3))
    return edit.carry(copied, copied.ids[-1], transform)


_EDITS: dict[EditKind, Callable[[Scene, int, torch.Tensor], Scene]] = {
    "remove": lambda scene, name, transform: edit.remove(scene, name),
    "move": edit.carry,
    "add": _with_carried_copy,
}
