"""Exact distances to triangle meshes, inside and outside, and the mesh as a `Solid`."""

from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

_LARGEST = 4.0
"""Triangles larger than this multiple of the median radius are compared with every point."""

_POINTS_AT_ONCE = 2000

_MOST_AT_ONCE = 2_000_000
"""Pairs of points and triangles whose solid angles are evaluated at once."""


class MeshSolid:
    """The inside of a triangle mesh in the object frame; a `datagen.shapes.shape.Solid`."""

    def __init__(self, vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], *, closed: bool):
        self.triangles = np.ascontiguousarray(vertices[faces])
        self.closed = closed
        self.low, self.high = np.min(vertices, axis=0), np.max(vertices, axis=0)

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Metres to the surface, negative inside; surfaces with holes have no inside and no negative distances."""
        return np.where(self.inside(points), -1.0, 1.0) * self.distance(points)

    def inside(self, points: Float[np.ndarray, "point 3"]) -> np.ndarray:
        """Whether points lie inside; False for surfaces with holes."""
        inside = np.zeros(len(points), bool)
        if self.closed:
            rows = np.flatnonzero(np.all((points > self.low) & (points < self.high), axis=1))
            inside[rows] = winding_numbers(self.triangles, points[rows]) > 0.5
        return inside

    def distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Exact unsigned distance to the surface, metres."""
        parts = [self._distance(points[i : i + _POINTS_AT_ONCE]) for i in range(0, len(points), _POINTS_AT_ONCE)]
        return np.concatenate([*parts, np.zeros(0)])

    def within(self, points: Float[np.ndarray, "point 3"], limit: float) -> Bool[np.ndarray, "point"]:
        """Whether points lie at most `limit` metres from the surface."""
        tree, _, radius, large = self._tree
        near = np.all((points > self.low - limit) & (points < self.high + limit), axis=1)
        rows = np.flatnonzero(near)
        nearest, _ = tree.query(points[rows], distance_upper_bound=limit + radius)
        near[rows] = np.isfinite(nearest)
        for row in large:
            near[rows] |= squared_distances(points[rows], self.triangles[row]) <= limit**2
        near[near] = self.distance(points[near]) <= limit
        return near

    def distance_to(
        self, faces: Int[np.ndarray, "point"], points: Float[np.ndarray, "point 3"]
    ) -> Float[np.ndarray, "point"]:
        """Distance of each point to the triangle of its row: an upper bound of the distance to the surface."""
        return np.sqrt(squared_distances(points, self.triangles[faces]))

    @cached_property
    def _tree(self) -> tuple[KDTree, np.ndarray, float, np.ndarray]:
        """Centres of the small triangles, their rows, their largest radius, and the rows of the large triangles."""
        centers = np.mean(self.triangles, axis=1)
        radii = np.sqrt(np.max(np.sum((self.triangles - centers[:, None]) ** 2, axis=2), axis=1))
        limit = _LARGEST * float(np.median(radii))
        small, large = np.flatnonzero(radii <= limit), np.flatnonzero(radii > limit)
        return KDTree(centers[small]), small, float(np.max(radii[small], initial=0.0)), large

    def _distance(self, points: np.ndarray) -> np.ndarray:
        tree, small, radius, large = self._tree
        best = np.full(len(points), np.inf)
        for row in large:
            best = np.minimum(best, squared_distances(points, self.triangles[row]))
        nearest, _ = tree.query(points)
        # A triangle contains its centre, so that nothing farther than this can be the nearest.
        reach = np.minimum(nearest, np.sqrt(best)) + radius + 1e-12
        found = tree.query_ball_point(points, reach)
        counts = np.array([len(rows) for rows in found])
        rows = np.repeat(np.arange(len(points)), counts)
        if len(rows):
            faces = small[np.concatenate([np.asarray(one, np.int64) for one in found])]
            np.minimum.at(best, rows, squared_distances(points[rows], self.triangles[faces]))
        return np.sqrt(best)


def squared_distances(
    points: Float[np.ndarray, "point 3"], triangles: Float[np.ndarray, "*point 3 3"]
) -> Float[np.ndarray, "point"]:
    """Squared distance of each point to one triangle for all points, or to the triangle of its row."""
    a, b, c = (triangles[..., i, :] for i in range(3))
    normal = np.cross(b - a, c - a)
    area = np.sum(normal**2, axis=-1)
    height = np.sum((points - a) * normal, axis=-1)
    inside = area > 0
    best = np.full(len(points), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, offset = end - start, points - start
        inside = inside & (np.sum(np.cross(edge, offset) * normal, axis=-1) >= 0)
        length = np.sum(edge**2, axis=-1)
        share = np.clip(np.sum(offset * edge, axis=-1) / np.where(length > 0, length, 1), 0, 1)
        best = np.minimum(best, np.sum((offset - share[..., None] * edge) ** 2, axis=-1))
    return np.where(inside, height**2 / np.where(area > 0, area, 1), best)


def winding_numbers(
    triangles: Float[np.ndarray, "face 3 3"], points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point"]:
    """Sum of the solid angles of all triangles at each point, over 4 pi: 1 inside of a closed surface, 0 outside.

    These are the generalised winding numbers of Jacobson et al. (2013).
    """
    chunk = max(1, _MOST_AT_ONCE // max(1, len(triangles)))
    parts = [_solid_angles(triangles, points[start : start + chunk]) for start in range(0, len(points), chunk)]
    return np.concatenate([*parts, np.zeros(0)])


def _solid_angles(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Solid angles by Van Oosterom and Strackee (1983)."""
    a, b, c = (triangles[None, :, i] - points[:, None] for i in range(3))
    la, lb, lc = (np.sqrt(np.einsum("pfi,pfi->pf", x, x)) for x in (a, b, c))
    volume = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    across = (
        la * lb * lc
        + np.einsum("pfi,pfi->pf", a, b) * lc
        + np.einsum("pfi,pfi->pf", b, c) * la
        + np.einsum("pfi,pfi->pf", c, a) * lb
    )
    return np.sum(np.arctan2(volume, across), axis=1) / (2 * np.pi)
