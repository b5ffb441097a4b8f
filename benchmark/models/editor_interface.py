"""Interface of editors: NumPy in, NumPy out.

An editor infers a scene from a clip. The scene can be edited, and rendered from the cameras of the clip in chosen
frames. Objects are named by their labels in the editor's own segmentation of the clip.
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
    """Images of a scene, edited or not, from the cameras of a clip."""

    rgb: Float[np.ndarray, "frame view height width 3"]
    """sRGB in 0..1."""
    depth: Float[np.ndarray, "frame view height width"]
    """Planar z in metres; in ground truth, 0 without a return."""
    labels: Integer[np.ndarray, "frame view height width"]
    """Object of each pixel, 0 = background."""


@runtime_checkable
class EditableScene(Protocol):
    """A scene inferred by an editor."""

    @property
    def labels(self) -> Integer[np.ndarray, "frame seen height width"]:
        """Segmentation of the views that the editor uses, from the first on; 0 = background."""
        ...

    def render(self, frames: Sequence[int]) -> Picture:
        """Render all views of the unedited scene."""
        ...

    def edited(self, kind: EditKind, label: int, transform: Float[np.ndarray, "4 4"], frames: Sequence[int]) -> Picture:
        """Render all views after an edit of one object.

        The object is removed, or moved by a rigid transform of the world (metres), or copied with a moved copy.
        """
        ...


@runtime_checkable
class Editor(Protocol):
    """A model whose scenes can be edited."""

    def infer(self, clip: Clip) -> EditableScene:
        """Infer the scene of a clip."""
        ...
