"""Exact solids: signed distances without triangles, to check meshes and renderers against.

Every solid lives in its own frame (metres, main axis z); `Placed` moves it. The distance to a union of solids is the
least of theirs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from datagen.shapes.shape import Solid


@dataclass(frozen=True, eq=False)
class Placed:
    """A solid in another frame."""

    solid: Solid
    rotation: Float[np.ndarray, "3 3"]
    """outer_from_local; columns are the solid's axes."""
    translation: Float[np.ndarray, "3"]
    """The solid's origin in the outer frame, metres."""

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Signed distance to the moved solid; exact wherever the solid's own distance is."""
        return self.solid.signed_distance((points - self.translation) @ self.rotation)


@dataclass(frozen=True)
class Sphere:
    """A ball around the origin."""

    radius: float

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact everywhere."""
        return _length(points) - self.radius


@dataclass(frozen=True)
class Box:
    """A box around the origin, sides along the axes."""

    size: tuple[float, float, float]
    """Full side lengths."""

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact everywhere."""
        excess = np.abs(points) - 0.5 * np.array(self.size)
        return _length(np.maximum(excess, 0)) + np.minimum(excess.max(axis=-1), 0)


@dataclass(frozen=True)
class Capsule:
    """All points within `radius` of a piece of the z axis around the origin."""

    radius: float
    length: float
    """Length of the cylindrical part."""

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact everywhere."""
        beyond = np.maximum(np.abs(points[:, 2]) - 0.5 * self.length, 0)
        return _length(np.stack([points[:, 0], points[:, 1], beyond], axis=-1)) - self.radius


@dataclass(frozen=True)
class Torus:
    """A ring about the z axis with a round cross-section."""

    ring_radius: float
    """Radius of the circle in the middle of the tube."""
    tube_radius: float

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact everywhere."""
        across = _length(points[:, :2]) - self.ring_radius
        return np.hypot(across, points[:, 2]) - self.tube_radius


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid around the origin, its half axes along x, y, z."""

    half_axes: tuple[float, float, float]

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact everywhere, by Newton's method for the parameter t of the closest point e^2 y / (t + e^2).

        Eberly, "Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid": t is the largest root of
        sum (e y / (t + e^2))^2 - 1, which is convex and falls, so that Newton's steps from its left never overshoot.
        """
        scale = max(self.half_axes)
        e = np.array(self.half_axes) / scale
        y = np.maximum(np.abs(points) / scale, 1e-12)
        # With s = t + min(e)^2 nothing cancels near the middle, where t + e^2 is tiny.
        gap = e * e - e.min() ** 2
        s = np.max(e * y - gap, axis=-1, keepdims=True)
        for _ in range(40):
            square = (e * y / (s + gap)) ** 2
            step = (square.sum(-1, keepdims=True) - 1) / (2 * (square / (s + gap)).sum(-1, keepdims=True))
            s = s + np.maximum(step, 0)
        closest = e * e * y / (s + gap)
        return scale * np.sign(s[:, 0] - e.min() ** 2) * _length(y - closest)


@dataclass(frozen=True, eq=False)
class ConvexPolyhedron:
    """The points that lie behind all of some planes."""

    normals: Float[np.ndarray, "plane 3"]
    """Unit vectors that point outwards."""
    offsets: Float[np.ndarray, "plane"]
    """Distance of each plane from the origin along its normal."""

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact inside and in front of faces; too short in front of edges and corners."""
        distance = np.full(len(points), -np.inf)
        for start in range(0, len(self.offsets), 16):
            rows = slice(start, start + 16)
            distance = np.maximum(distance, (points @ self.normals[rows].T - self.offsets[rows]).max(axis=1))
        return distance


@dataclass(frozen=True, eq=False)
class Extrusion:
    """A prism along z, symmetric about z = 0, over a simple polygon in the xy plane."""

    polygon: Float[np.ndarray, "corner 2"]
    height: float

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact everywhere."""
        sideways = polygon_distance(points[:, :2], self.polygon)
        upwards = np.abs(points[:, 2]) - 0.5 * self.height
        outside = np.hypot(np.maximum(sideways, 0), np.maximum(upwards, 0))
        return outside + np.minimum(np.maximum(sideways, upwards), 0)


@dataclass(frozen=True, eq=False)
class Revolution:
    """Solid that a polygon in the half plane (r >= 0, z) sweeps when it turns about the z axis.

    Cylinders, cones, bottles and, with a polygon that leaves out the cavity, cups.
    """

    profile: Float[np.ndarray, "corner 2"]
    """Corners (r, z); edges on the axis are no surface."""

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact everywhere."""
        radial = np.stack([_length(points[:, :2]), points[:, 2]], axis=-1)
        following = np.roll(self.profile, -1, axis=0)
        return polygon_distance(radial, self.profile, (self.profile[:, 0] > 0) | (following[:, 0] > 0))


def polygon_distance(
    points: Float[np.ndarray, "point 2"],
    polygon: Float[np.ndarray, "corner 2"],
    is_surface: Bool[np.ndarray, "corner"] | None = None,
) -> Float[np.ndarray, "point"]:
    """Signed distance to a simple polygon, negative inside; edge i runs from corner i to the next one.

    Edges where `is_surface` is false bound the inside but count as no boundary to be near to.
    """
    square = np.full(len(points), np.inf)
    inside = np.zeros(len(points), bool)
    for i, (start, end) in enumerate(zip(polygon, np.roll(polygon, -1, axis=0), strict=True)):
        edge, offset = end - start, points - start
        if is_surface is None or is_surface[i]:
            share = np.clip(offset @ edge / (edge @ edge), 0, 1)
            gap = offset - share[:, None] * edge
            square = np.minimum(square, gap[:, 0] ** 2 + gap[:, 1] ** 2)
        if start[1] != end[1]:
            crosses = (start[1] <= points[:, 1]) != (end[1] <= points[:, 1])
            inside ^= crosses & (points[:, 0] < start[0] + offset[:, 1] * (edge[0] / edge[1]))
    return np.where(inside, -1.0, 1.0) * np.sqrt(square)


def _length(vectors: Float[np.ndarray, "point axis"]) -> Float[np.ndarray, "point"]:
    return np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
