"""Largest plane in a point cloud, by RANSAC (Fischler and Bolles, 1981) and least-squares refinement."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

HYPOTHESES = 200
"""Number of random triples. If half of the points are on the plane, all triples miss it with probability 3e-12."""
SAMPLE = 4096
"""Number of points that vote; enough for an accuracy below a millimetre at any image size."""
TOLERANCE = 0.01
"""Largest distance of inliers in metres: three times the noise of a depth sensor at 1 m."""
REFINEMENTS = 4
"""Number of least-squares fits, each to the inliers of the previous plane."""
LEAST_AREA = 1e-12
"""Smallest area in square metres of three points that define a plane."""
FEWEST_POINTS = 16
"""Smallest number of points to look for a plane."""


@dataclass(frozen=True, eq=False)
class Plane:
    """Points x with normal . x = offset, in metres, in the frame of the fitted points."""

    normal: Float[np.ndarray, "3"]
    """Unit length."""
    offset: float
    spread: float
    """Standard deviation of the inliers along the normal, metres."""

    def height(self, points: Float[np.ndarray, "*point 3"]) -> Float[np.ndarray, "*point"]:
        """Signed distance of points in metres, positive on the side of the normal."""
        return points @ self.normal - self.offset

    def oriented_towards(self, viewpoints: Float[np.ndarray, "viewpoint 3"]) -> "Plane":
        """Plane whose normal points to the mean of the viewpoints."""
        if np.mean(self.height(viewpoints)) >= 0:
            return self
        return Plane(-self.normal, -self.offset, self.spread)


def fit_plane(points: Float[np.ndarray, "point 3"], rng: np.random.Generator) -> Plane | None:
    """Fit the plane with most inliers; None if there are too few points, or all are on one line.

    The result does not depend on the orientation of the axes.
    """
    if len(points) < FEWEST_POINTS:
        return None
    sample = points[rng.integers(len(points), size=SAMPLE)]
    center = sample.mean(axis=0)
    normals, offsets = _hypotheses(sample - center, rng)
    votes = np.count_nonzero(np.abs((sample - center) @ normals.T - offsets) < TOLERANCE, axis=0)
    best = int(np.argmax(votes))
    if votes[best] == 0:
        return None
    return refine_plane(Plane(normals[best], float(offsets[best] + normals[best] @ center), TOLERANCE), sample)


def refine_plane(plane: Plane, points: Float[np.ndarray, "point 3"]) -> Plane:
    """Fit a plane to those of the points that are near it."""
    for _ in range(REFINEMENTS):
        plane = _refine(plane, points)
    return plane


def _hypotheses(
    points: Float[np.ndarray, "point 3"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "hypothesis 3"], Float[np.ndarray, "hypothesis"]]:
    """Planes through random triples, as normals and offsets; collinear triples get an infinite offset."""
    a, b, c = points[rng.integers(len(points), size=(3, HYPOTHESES))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(lengths, LEAST_AREA)[:, None]
    return normals, np.where(lengths > LEAST_AREA, np.sum(normals * a, axis=1), np.inf)


def _refine(plane: Plane, points: Float[np.ndarray, "point 3"]) -> Plane:
    """Fit the points within three spreads of the plane by least squares, and estimate their spread robustly."""
    near = points[np.abs(plane.height(points)) <= min(TOLERANCE, max(3 * plane.spread, 1e-4))]
    if len(near) < 3:
        return plane
    center = near.mean(axis=0)
    normal = np.linalg.eigh(np.cov((near - center).T))[1][:, 0]
    residual = np.abs((near - center) @ normal)
    # The median is robust against points of objects; 1.4826 scales it to the standard deviation of a Gaussian.
    return Plane(normal, float(normal @ center), float(1.4826 * np.median(residual)))
