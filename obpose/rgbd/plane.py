"""The largest plane in a cloud of points, by RANSAC (Fischler and Bolles, 1981) and a least-squares refinement."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

HYPOTHESES = 200
"""Triples tried: where half of the points are the plane's, all of them miss it with probability 3e-12."""
SAMPLE = 4096
"""Points that vote; enough to find the plane to a fraction of a millimetre, whatever the image's size."""
TOLERANCE = 0.01
"""Metres from a hypothesis within which a point votes for it; three times a depth sensor's noise at 1 m."""
REFINEMENTS = 4
"""Least-squares fits, each to the points near the plane before it."""
LEAST_AREA = 1e-12
"""Square metres that three points must span to define a plane."""
FEWEST_POINTS = 16
"""A cloud with fewer has no plane worth the name."""


@dataclass(frozen=True, eq=False)
class Plane:
    """The points x with normal . x = offset; world frame, metres."""

    normal: Float[np.ndarray, "3"]
    """Unit length."""
    offset: float
    spread: float
    """Standard deviation of the plane's own points across it, metres."""

    def height(self, points: Float[np.ndarray, "*point 3"]) -> Float[np.ndarray, "*point"]:
        """Signed distance in metres, positive on the side to which the normal points."""
        return points @ self.normal - self.offset

    def oriented_towards(self, viewpoints: Float[np.ndarray, "viewpoint 3"]) -> "Plane":
        """The same plane, its normal to the side of the viewpoints' mean."""
        if np.mean(self.height(viewpoints)) >= 0:
            return self
        return Plane(-self.normal, -self.offset, self.spread)


def fit_plane(points: Float[np.ndarray, "point 3"], rng: np.random.Generator) -> Plane | None:
    """The plane near which most of the points lie; None where there are too few, or all on one line.

    Nothing in it depends on how the world's axes are turned.
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
    plane = Plane(normals[best], float(offsets[best] + normals[best] @ center), TOLERANCE)
    for _ in range(REFINEMENTS):
        plane = _refine(plane, sample)
    return plane


def _hypotheses(
    points: Float[np.ndarray, "point 3"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "hypothesis 3"], Float[np.ndarray, "hypothesis"]]:
    """Normals and offsets of the planes through random triples; triples on a line get a plane infinitely far away."""
    a, b, c = points[rng.integers(len(points), size=(3, HYPOTHESES))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(lengths, LEAST_AREA)[:, None]
    return normals, np.where(lengths > LEAST_AREA, np.sum(normals * a, axis=1), np.inf)


def _refine(plane: Plane, points: Float[np.ndarray, "point 3"]) -> Plane:
    """Least squares over the points within three spreads of the plane, and their spread, robustly."""
    near = points[np.abs(plane.height(points)) <= min(TOLERANCE, max(3 * plane.spread, 1e-4))]
    if len(near) < 3:
        return plane
    center = near.mean(axis=0)
    normal = np.linalg.eigh(np.cov((near - center).T))[1][:, 0]
    residual = np.abs((near - center) @ normal)
    # The median is not moved by the feet of objects; 1.4826 makes it a normal distribution's standard deviation.
    return Plane(normal, float(normal @ center), float(1.4826 * np.median(residual)))
