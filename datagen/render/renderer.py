"""What a renderer is, and what it gives back."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from datagen.scene import Camera, Scene
from datagen.shapes.shape import Shape

NEAREST = 0.05
"""Planar depth up to which renderers cut surfaces away, metres; scenes keep all that their cameras see beyond it."""


@dataclass(frozen=True, eq=False)
class Image:
    """One rendered view."""

    rgb: UInt8[np.ndarray, "height width 3"]
    """sRGB, anti-aliased."""
    depth: Float32[np.ndarray, "height width"]
    """Planar z in metres at the pixel's centre, 0 where nothing is hit."""
    segmentation: UInt8[np.ndarray, "height width"]
    """Object id (row in the scene's bodies plus one) at the pixel's centre, 0 for table and backdrop."""
    amodal_pixels: Int[np.ndarray, "object"]
    """Pixels whose centre each object would cover if it were alone."""


@runtime_checkable
class Renderer(Protocol):
    """Turns scenes into images. One scene is loaded at a time; poses and cameras may change between calls."""

    name: str
    version: int
    """Rises when its pictures change; part of a dataset's identity."""

    def load(self, scene: Scene, shapes: Sequence[Shape]) -> None:
        """Take over a scene's materials, lights and shapes, row by row as in `scene.bodies`."""
        ...

    def render(
        self, world_from_object: Float[np.ndarray, "object 4 4"], camera: Camera, width: int, height: int
    ) -> Image:
        """Render the loaded scene with its objects at the given poses."""
        ...
