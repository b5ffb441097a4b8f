"""Intersection over union of the volumes of two boxes in space, exact up to rounding."""

import itertools

import numpy as np
import scipy
from jaxtyping import Float

CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
"""Corners of the box with sides of 1 around the origin."""
EDGES = np.array([(i, j) for i, j in itertools.combinations(range(8), 2) if np.sum(CORNERS[i] != CORNERS[j]) == 1])
"""Pairs of `CORNERS` that an edge of the box joins."""
_TOLERANCE = 1e-9
"""Tolerance in metres within which a point outside a box counts as inside."""

Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]
"""Centre (metres), rotation (world from box) and side lengths along the box's axes (metres)."""


def box_overlap(one: Box, other: Box) -> float:
    """Intersection over union of two boxes that may be turned in any way.

    Both are convex: what they share is the convex hull of the corners of each that lie in the other and of the points
    where the edges of each pierce the faces of the other.

    >>> still = (np.zeros(3), np.eye(3), np.ones(3))
    >>> round(box_overlap(still, (np.array([0.5, 0.0, 0.0]), np.eye(3), np.ones(3))), 6)
    0.333333
    """
    volumes = float(np.prod(one[2])), float(np.prod(other[2]))
    shared = _hull_volume(np.concatenate([_inside(one, other), _inside(other, one)]))
    shared = min(shared, *volumes)
    union = sum(volumes) - shared
    return shared / union if union > 0 else 0.0


def box_corners(box: Box) -> Float[np.ndarray, "8 3"]:
    """Corners in the world, metres."""
    center, rotation, size = box
    return center + (CORNERS * size) @ rotation.T


def _inside(one: Box, other: Box) -> Float[np.ndarray, "point 3"]:
    """The first box's corners in the second, and where its edges enter and leave the second; world frame."""
    center, rotation, size = other
    corners = (box_corners(one) - center) @ rotation
    start, end = corners[EDGES[:, 0]], corners[EDGES[:, 1]]
    points = np.concatenate([corners, _piercings(start, end, size / 2)])
    within = np.all(np.abs(points) <= size / 2 + _TOLERANCE, axis=1)
    return points[within] @ rotation.T + center


def _piercings(
    start: Float[np.ndarray, "edge 3"], end: Float[np.ndarray, "edge 3"], half: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "point 3"]:
    """Intersect segments with the planes of the faces of a box of these half sides."""
    way = end - start
    found = []
    for axis, side in itertools.product(range(3), (-1.0, 1.0)):
        parallel = np.abs(way[:, axis]) < _TOLERANCE
        share = (side * half[axis] - start[:, axis]) / np.where(parallel, 1.0, way[:, axis])
        meets = ~parallel & (share >= 0) & (share <= 1)
        found.append((start + share[:, None] * way)[meets])
    return np.concatenate(found)


def _hull_volume(points: Float[np.ndarray, "point 3"]) -> float:
    """Volume of the convex hull; 0 if the points lie in one plane or are too few."""
    if len(points) < 4:
        return 0.0
    try:
        return float(scipy.spatial.ConvexHull(points).volume)
    except scipy.spatial.QhullError:
        return 0.0
