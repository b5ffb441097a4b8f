"""The box of least volume around a shape, found from the shape's extent in each direction.

A shape's convex hull is that of a few points and rounded discs; its reach along a direction d, the support function, is
therefore known in closed form, and the volume of the box along any three axes costs no more than a matrix product.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from datagen.shapes.shape import Numbers, OrientedBox

STARTS = 4
"""Best coarse orientations that are refined."""

WORTHWHILE = 0.999
"""Share of the aligned box's volume that a turned box must fall below to be preferred."""

_SPACING = 0.2
"""Angle between neighbouring orientations of the coarse grid, radians."""


@dataclass(frozen=True, eq=False)
class Outline:
    """Points and rounded ellipses that have the same convex hull as a solid."""

    points: Float[np.ndarray, "point 3"]
    centers: Float[np.ndarray, "round 3"]
    matrices: Float[np.ndarray, "round 3 3"]
    """Round i reaches |matrix_i d| + rounding_i from its centre along the unit vector d."""
    roundings: Float[np.ndarray, "round"]

    @staticmethod
    def of_points(points: Float[np.ndarray, "point 3"]) -> "Outline":
        """Outline of a polyhedron with the given corners."""
        return Outline(points, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0))

    @staticmethod
    def of_ellipsoid(half_axes: Numbers) -> "Outline":
        """Outline of an ellipsoid around the origin."""
        return Outline(np.zeros((0, 3)), np.zeros((1, 3)), np.diag(half_axes)[None], np.zeros(1))

    @staticmethod
    def of_circles(
        radii: Float[np.ndarray, "round"], heights: Float[np.ndarray, "round"], rounding: float = 0.0
    ) -> "Outline":
        """Outline of circles around the z axis at the given z, grown by balls of radius `rounding`."""
        centers = np.stack([np.zeros_like(heights), np.zeros_like(heights), heights], axis=1)
        matrices = radii[:, None, None] * np.diag([1.0, 1.0, 0.0])
        return Outline(np.zeros((0, 3)), centers, matrices, np.full(len(radii), rounding))

    @staticmethod
    def union(outlines: Sequence["Outline"]) -> "Outline":
        """Outline of several solids together."""
        return Outline(
            np.concatenate([outline.points for outline in outlines]),
            np.concatenate([outline.centers for outline in outlines]),
            np.concatenate([outline.matrices for outline in outlines]),
            np.concatenate([outline.roundings for outline in outlines]),
        )

    def placed(self, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Outline":
        """Outline after the motion `outer = rotation @ local + translation`."""
        return Outline(
            self.points @ rotation.T + translation,
            self.centers @ rotation.T + translation,
            self.matrices @ rotation.T,
            self.roundings,
        )

    def span(
        self, directions: Float[np.ndarray, "direction 3"]
    ) -> tuple[Float[np.ndarray, "direction"], Float[np.ndarray, "direction"]]:
        """Least and greatest coordinate of the solid along unit vectors."""
        lows, highs = [], []
        if len(self.points):
            along = directions @ self.points.T
            lows.append(np.minimum.reduce(along, axis=1))
            highs.append(np.maximum.reduce(along, axis=1))
        if len(self.centers):
            along = directions @ self.centers.T
            reach = (directions @ self.matrices.reshape(-1, 3).T).reshape(len(directions), -1, 3)
            reach = np.sqrt(np.einsum("dri,dri->dr", reach, reach)) + self.roundings
            lows.append(np.minimum.reduce(along - reach, axis=1))
            highs.append(np.maximum.reduce(along + reach, axis=1))
        return np.minimum(lows[0], lows[-1]), np.maximum(highs[0], highs[-1])


def minimum_box(outline: Outline, *, aligned: bool = False) -> OrientedBox:
    """The box of least volume that holds the outline, to about one percent of its volume.

    With `aligned`, the box along the outline's own axes. A turned box is preferred only where it is clearly smaller.
    """
    rotation = np.eye(3)
    if not aligned:
        turned, volume = _search(outline)
        if volume < WORTHWHILE * _volumes(outline, rotation[None])[0]:
            rotation = turned
    low, high = outline.span(rotation.T)
    return OrientedBox(rotation @ (0.5 * (low + high)), rotation, high - low)


def _search(outline: Outline) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Coarse grid over all orientations of a box, then a shrinking pattern around the best few."""
    candidates = _orientations()
    volumes = _volumes(outline, candidates)
    best = np.argsort(volumes, kind="stable")[:STARTS]
    rotations, volumes = candidates[best], volumes[best]
    for pattern in _patterns():
        tried = (rotations[:, None] @ pattern).reshape(-1, 3, 3)
        tried_volumes = _volumes(outline, tried).reshape(len(rotations), -1)
        choice = np.argmin(tried_volumes, axis=1)
        rows = np.arange(len(rotations))
        better = tried_volumes[rows, choice] < volumes
        volumes = np.where(better, tried_volumes[rows, choice], volumes)
        chosen = tried.reshape(len(rotations), -1, 3, 3)[rows, choice]
        rotations = np.where(better[:, None, None], chosen, rotations)
    winner = int(np.argmin(volumes))
    return rotations[winner], float(volumes[winner])


def _volumes(outline: Outline, rotations: Float[np.ndarray, "box 3 3"]) -> Float[np.ndarray, "box"]:
    low, high = outline.span(np.swapaxes(rotations, 1, 2).reshape(-1, 3))
    return np.prod((high - low).reshape(-1, 3), axis=1)


@lru_cache(maxsize=1)
def _orientations() -> Float[np.ndarray, "box 3 3"]:
    """Evenly spread orientations of a box; each stands for all 24 that give the same box."""
    limit = np.sqrt(2) - 1
    steps = np.arange(-limit, limit + 1e-9, _SPACING / 2)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    # Rodrigues vectors of rotations closer to the identity than to any other rotation of the cube.
    return _from_rodrigues(grid[np.abs(grid).sum(axis=1) <= 1 + 1e-9])


@lru_cache(maxsize=1)
def _patterns() -> tuple[Float[np.ndarray, "turn 3 3"], ...]:
    steps = np.array([[x, y, z] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) for z in (-1.0, 0.0, 1.0)])
    steps = np.delete(steps, 13, axis=0)
    return tuple(_from_rodrigues(steps * (0.05 * 0.5**level)) for level in range(8))


def _from_rodrigues(vectors: Float[np.ndarray, "rotation 3"]) -> Float[np.ndarray, "rotation 3 3"]:
    """Rotations of vectors whose direction is the axis and whose length is the tangent of half the angle."""
    x, y, z = vectors.T
    rotations = np.empty((len(vectors), 3, 3))
    square = x * x + y * y + z * z
    rotations[:, 0, 0], rotations[:, 1, 1], rotations[:, 2, 2] = (1 - square + 2 * a * a for a in (x, y, z))
    rotations[:, 0, 1], rotations[:, 1, 0] = 2 * (x * y - z), 2 * (x * y + z)
    rotations[:, 0, 2], rotations[:, 2, 0] = 2 * (x * z + y), 2 * (x * z - y)
    rotations[:, 1, 2], rotations[:, 2, 1] = 2 * (y * z - x), 2 * (y * z + x)
    return rotations / (1 + square)[:, None, None]
