"""Colours and directions of light as both renderers need them."""

import numpy as np
from jaxtyping import Float

from datagen.scene import Vector


def linear(srgb: Vector) -> Float[np.ndarray, "3"]:
    """Linear RGB of an sRGB colour in 0..1 (IEC 61966-2-1)."""
    value = np.asarray(srgb, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def light_axes(direction: Vector) -> Float[np.ndarray, "3 3"]:
    """Right-handed axes in rows, the last one towards a light in the given world direction."""
    toward = np.asarray(direction, np.float64)
    toward = toward / np.sqrt(np.sum(toward * toward))
    side = np.array([1.0, 0.0, 0.0]) if abs(toward[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    u = side - np.sum(side * toward) * toward
    u = u / np.sqrt(np.sum(u * u))
    return np.stack([u, np.cross(toward, u), toward])
