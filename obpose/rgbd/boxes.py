"""Upright boxes around the visible points of objects on a table."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

TRIMMED = 0.01
"""Share of the points at each end of an axis that may be outside of the box: stray points beside depth edges."""
RESTING = 0.02
"""Boxes whose lowest points are nearer to the table than this, metres, stand on it: feet are hidden or lost."""


@dataclass(frozen=True, eq=False)
class Box:
    """Upright box in the world frame."""

    center: Float[np.ndarray, "3"]
    """Centre, metres."""
    rotation: Float[np.ndarray, "3 3"]
    """world_from_box: a rotation about z; x is the longer horizontal side."""
    size: Float[np.ndarray, "3"]
    """Sides along the box's axes, metres."""

    @property
    def corners(self) -> Float[np.ndarray, "8 3"]:
        """Corners in the world frame."""
        signs = np.array(np.meshgrid((-0.5, 0.5), (-0.5, 0.5), (-0.5, 0.5), indexing="ij")).reshape(3, 8).T
        return (signs * self.size) @ self.rotation.T + self.center


def upright_box(points: Float[np.ndarray, "point 3"]) -> Box:
    """Find the box with the smallest base around points above a table at z = 0.

    One side of the smallest rectangle around a convex polygon lies on a side of the polygon (Freeman and Shapira 1975).
    """
    middle = np.median(points[:, :2], axis=0)
    flat = points[:, :2] - middle
    best = min((_extent(flat, angle) for angle in _angles(flat)), key=lambda found: np.prod(found[2]))
    angle, center, sides = best
    if sides[1] > sides[0]:
        angle, center, sides = angle + np.pi / 2, np.array([center[1], -center[0]]), sides[::-1]
    cosine, sine = np.cos(angle), np.sin(angle)
    rotation = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    low, high = np.quantile(points[:, 2], [TRIMMED, 1 - TRIMMED])
    low = 0.0 if low < RESTING else low
    where = rotation[:2, :2] @ center + middle
    return Box(np.array([*where, (low + high) / 2]), rotation, np.array([*sides, max(high - low, 0.0)]))


def _angles(flat: Float[np.ndarray, "point 2"]) -> list[float]:
    """Directions of the sides of the convex hull, modulo a right angle."""
    try:
        hull = flat[ConvexHull(flat).vertices]
    except (QhullError, ValueError):
        return [0.0]
    sides = np.roll(hull, -1, axis=0) - hull
    return [float(angle) for angle in np.arctan2(sides[:, 1], sides[:, 0]) % (np.pi / 2)]


def _extent(flat: Float[np.ndarray, "point 2"], angle: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Angle, centre and sides of the rectangle at an angle, in its own axes."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = flat @ np.array([[cosine, -sine], [sine, cosine]])
    low, high = np.quantile(turned, [TRIMMED, 1 - TRIMMED], axis=0)
    return angle, (low + high) / 2, high - low
