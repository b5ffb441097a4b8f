"""The table of a recording: a large plane near the camera, rather than a wall, the floor, or the side of a box."""

import numpy as np
from jaxtyping import Float

from obpose.rgbd.plane import FEWEST_POINTS, SAMPLE, TOLERANCE, Plane, fit_plane

PLANES = 4
"""Planes that are compared."""
WIDTH = 0.6
"""Metres, the root of a plane's area in view; smaller planes are less likely a table."""
_NEAREST, _OF_QUANTILE = 0.5, 0.25
"""Share of the lower quartile of the distances within which all points are equally near, so that what is right before
the lens does not outweigh everything else."""
_LEAST_DISTANCE = 1e-3
"""Metres."""


def find_table(points: Float[np.ndarray, "point 3"], *, seed: int = 0) -> Plane | None:
    """Find the plane that is most likely the table, its normal towards the camera; None where there is no plane.

    Of the largest planes it is the one with the highest score: the number of its points, each divided by the cube of
    its distance from the camera, times the cube of the plane's width up to `WIDTH`. A wall at twice the distance of the
    table loses even where it fills more pixels, and so does the side of a box on the table.

    Args:
        points: What the camera sees, camera frame, metres.
        seed: Of the search for planes.
    """
    if not len(points):
        return None
    rng = np.random.default_rng(seed)
    sample = _near_sample(points, rng)
    best = max(_planes(sample, rng), key=lambda plane: _score(plane, sample), default=None)
    return None if best is None else best.oriented_towards(np.zeros((1, 3)))


def table_points(points: Float[np.ndarray, "point 3"], plane: Plane) -> Float[np.ndarray, "some 3"]:
    """Select the points that lie on the plane."""
    return points[np.abs(plane.height(points)) < TOLERANCE]


def _near_sample(points: Float[np.ndarray, "point 3"], rng: np.random.Generator) -> Float[np.ndarray, "sample 3"]:
    """Draw points with probabilities that fall with the cube of their distance."""
    distance = np.linalg.norm(points, axis=1)
    nearest = max(_NEAREST * np.quantile(distance, _OF_QUANTILE), _LEAST_DISTANCE)
    weight = np.maximum(distance, nearest) ** -3.0
    return points[rng.choice(len(points), 2 * SAMPLE, p=weight / weight.sum())]


def _planes(points: Float[np.ndarray, "point 3"], rng: np.random.Generator) -> list[Plane]:
    """Find the largest plane, then the largest one in the rest, and so on."""
    found: list[Plane] = []
    while len(found) < PLANES and len(points) >= FEWEST_POINTS:
        plane = fit_plane(points, rng)
        if plane is None:
            break
        found.append(plane)
        points = points[np.abs(plane.height(points)) > 2 * TOLERANCE]
    return found


def _score(plane: Plane, sample: Float[np.ndarray, "point 3"]) -> float:
    on_plane = table_points(sample, plane)
    if len(on_plane) < 3:
        return 0.0
    # The two larger variances are those along the plane; 12 times that of a uniform distribution is the square of the
    # side's length, so that the fourth root of their product gives the root of the area.
    _, short, long = np.maximum(np.linalg.eigvalsh(np.cov(on_plane.T)), 0.0)
    width = float(np.sqrt(12 * np.sqrt(short * long)))
    return len(on_plane) * min(1.0, width / WIDTH) ** 3
