"""What an editor gets and what it gives back: NumPy in, NumPy out.

An editor looks at a clip once; the scene that it finds can be edited and rendered from the cameras of the clip, in the
frames that are asked for. Objects go by the labels that the editor's own segmentation of the clip gives them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Integer

from benchmark.models.interface import Clip
from datagen.schema import EditKind


@dataclass(frozen=True, eq=False)
class Picture:
    """What the cameras of a clip see of a scene, edited or not."""

    rgb: Float[np.ndarray, "frame view height width 3"]
    """sRGB in 0..1."""
    depth: Float[np.ndarray, "frame view height width"]
    """Planar z in metres; of a truth, 0 where nothing returns."""
    labels: Integer[np.ndarray, "frame view height width"]
    """Object of each pixel, 0 = background."""


@runtime_checkable
class EditableScene(Protocol):
    """A scene as an editor sees it."""

    @property
    def labels(self) -> Integer[np.ndarray, "frame seen height width"]:
        """Segmentation of the first views, as many as the editor looks at; 0 = background."""
        ...

    def render(self, frames: Sequence[int]) -> Picture:
        """All views, unedited."""
        ...

    def edited(self, kind: EditKind, label: int, transform: Float[np.ndarray, "4 4"], frames: Sequence[int]) -> Picture:
        """The same after an edit of one object.

        It is removed, or carried along by a rigid transform of the world (metres), or left with a copy that is carried.
        """
        ...


@runtime_checkable
class Editor(Protocol):
    """A model whose scenes can be edited."""

    def infer(self, clip: Clip) -> EditableScene:
        """The scene of a clip."""
        ...
