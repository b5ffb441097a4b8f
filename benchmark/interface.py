"""What a model gets and what it gives back: NumPy in, NumPy out, and never a label on the way in."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer, UInt8


@dataclass(frozen=True, eq=False)
class Clip:
    """What cameras that stand still saw of one scene. Frames of reference as in `datagen.geometry`."""

    rgb: UInt8[np.ndarray, "frame view height width 3"]
    """sRGB."""
    depth: Float32[np.ndarray, "frame view height width"]
    """Planar z in metres, 0 where there is no return."""
    valid: Bool[np.ndarray, "frame view height width"]
    """Whether the pixel has a depth."""
    k: Float[np.ndarray, "view 3 3"]
    """Camera matrices in pixels, pixel centres at +0.5."""
    world_from_camera: Float[np.ndarray, "view 4 4"]
    """Poses of the cameras, metres."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """One segmentation of a clip."""

    labels: Integer[np.ndarray, "frame view height width"]
    """Slot of every pixel, from 0 on; which slot stands for which object is the model's affair."""
    background_slot: int | None
    """The slot that the model means as background; None if it means none."""


@runtime_checkable
class Segmenter(Protocol):
    """A model under test. Its constructor takes no argument that the benchmark must know."""

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Learn from unlabelled clips, for at most `budget` seconds; all randomness comes from `seed`."""
        ...

    def segment(self, clip: Clip) -> Prediction:
        """Segment one clip; equal clips get equal predictions, whatever was segmented before."""
        ...
