"""Precision of renderers and of the stored format: the errors that even a correct image has.

Depth is planar, so an error of depth moves a point by that error times the length of the pixel's ray per unit of depth.
That length is 1 in the middle of an image and 4 at the side of a field of view of 150 degrees.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from datagen.schema import DEPTH_SCALE


@dataclass(frozen=True)
class Precision:
    """Errors of a renderer."""

    snap: float = 0.0
    """Distance by which a triangle's corners may move sideways, pixels."""
    depth_steps: float = 0.0
    """Step of the depth buffer at a depth of 1 m, metres; grows with the square of depth."""

    def sideways(self, depth: np.ndarray, focal: np.ndarray | float) -> np.ndarray:
        """Largest shift of a surface across the line of sight at a given depth, metres; focal length in pixels."""
        return self.snap * depth / focal

    def buffer(self, depth: np.ndarray) -> np.ndarray:
        """Largest error of the depth buffer at a given depth, metres."""
        return self.depth_steps * depth**2


OPENGL = Precision(snap=1 / 256, depth_steps=2.0**-24 / 0.05)
"""Precision of OpenGL: corners have 8 subpixel bits, and the depth buffer has 24 bits and a near plane at 5 cm."""

PRECISION = {"raster": Precision(), "pyrender": OPENGL}
"""Precision of each renderer by name."""


def rounding(rays: Float[np.ndarray, "*shape 3"], steps: float) -> Float[np.ndarray, "*shape"]:
    """Length along rays, in metres, of a number of steps of stored depth; rays are given per unit of depth."""
    return steps * DEPTH_SCALE * np.sqrt(np.sum(rays**2, axis=-1))
