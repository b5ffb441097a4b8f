"""How exactly a renderer and the format can say where a surface is: the errors that a correct image has.

Depth is planar, so that an error of depth moves a point by that error times the length of the pixel's ray per unit of
depth. That length is 1 in the middle of an image and 4 at the side of a field of view of 150 degrees.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from datagen.schema import DEPTH_SCALE


@dataclass(frozen=True)
class Precision:
    """Errors of a renderer."""

    snap: float = 0.0
    """Pixels by which it may move a triangle's corners sideways."""
    depth_steps: float = 0.0
    """Steps of its depth buffer at a depth of 1 m, metres; they grow with the square of depth."""

    def sideways(self, depth: np.ndarray, focal: np.ndarray | float) -> np.ndarray:
        """Metres by which a surface at a depth may be shifted across the line of sight; focal length in pixels."""
        return self.snap * depth / focal

    def buffer(self, depth: np.ndarray) -> np.ndarray:
        """Metres by which the depth buffer may be off."""
        return self.depth_steps * depth**2


OPENGL = Precision(snap=1 / 256, depth_steps=2.0**-24 / 0.05)
"""Corners have 8 bits below the pixel, and a depth buffer has 24 bits that start at 5 cm."""

PRECISION = {"raster": Precision(), "pyrender": OPENGL}
"""By the renderer's name."""


def rounding(rays: Float[np.ndarray, "*shape 3"], steps: float) -> Float[np.ndarray, "*shape"]:
    """Metres that so many steps of stored depth are along rays, which are given per unit of depth."""
    return steps * DEPTH_SCALE * np.sqrt(np.sum(rays**2, axis=-1))
