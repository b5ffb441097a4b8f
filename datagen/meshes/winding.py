"""Inside and outside of triangle meshes by generalised winding numbers (Jacobson et al. 2013)."""

import numpy as np
from jaxtyping import Float

_MOST_AT_ONCE = 2_000_000
"""Pairs of points and triangles that are evaluated at once."""


def winding_numbers(
    triangles: Float[np.ndarray, "face 3 3"], points: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point"]:
    """Sum of the solid angles of all triangles at each point, over 4 pi: 1 inside of a closed surface, 0 outside."""
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
