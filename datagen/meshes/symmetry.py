"""Rotational symmetry of a mesh about the z axis through its centre of mass; colours do not count."""

import numpy as np
from jaxtyping import Float

from datagen.meshes.distance import MeshSolid
from datagen.shapes.symmetry import about_z

TOLERANCE, MOST = 0.01, 0.03
"""Distances, as shares of the longest side, by which 95 % and all of a turned mesh may miss itself: scans are rough."""

_ORDERS = (2, 3, 4, 5, 6, 8)
_ROUND = 24
"""Number of steps of a full turn that a mesh must all match to count as round."""
_MOST_POINTS = 400


def find_symmetry(vertices: Float[np.ndarray, "vertex 3"], solid: MeshSolid) -> str:
    """Name of the rotation group, see `datagen.shapes.symmetry`; `C1` if no turn about z maps it to itself."""
    points = vertices[:: max(1, len(vertices) // _MOST_POINTS)]
    longest = float(np.max(np.ptp(vertices, axis=0)))

    def fits(rotation: np.ndarray) -> bool:
        distance = solid.distance(points @ rotation.T)
        return bool(np.max(distance) <= MOST * longest and np.quantile(distance, 0.95) <= TOLERANCE * longest)

    turns = [order for order in _ORDERS if fits(about_z(np.array([2 * np.pi / order]))[0])]
    if not turns:
        return "C1"
    order = str(max(turns))
    if len(turns) > 2 and all(fits(turn) for turn in about_z(2 * np.pi * np.arange(1, _ROUND // 2) / _ROUND)):
        order = "inf"
    return ("D" if fits(np.diag([1.0, -1.0, -1.0])) else "C") + order
