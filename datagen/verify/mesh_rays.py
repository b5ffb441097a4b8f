"""Pixels of meshes: distances to the triangles themselves, by ray casting instead of sphere tracing."""

import numpy as np
from jaxtyping import Bool, Float

from datagen.meshes.distance import MeshSolid
from datagen.meshes.raycast import first_hits
from datagen.shapes.shape import Shape

MARGIN = 5e-6
"""Metres by which rays are moved sideways to find the pixels at an outline, where rounding decides what they show."""

SEARCH = 3e-4
"""Metres along the line of sight, before and behind a point, within which the surface that it lies on is searched."""

_SIDES = np.array([(np.cos(angle), np.sin(angle)) for angle in np.pi * (0.25 + 0.5 * np.arange(4))])


def mesh_of(shape: Shape) -> MeshSolid | None:
    """The mesh of a shape of the family `mesh`; None for all others."""
    solid = shape.solids[0]
    return solid if isinstance(solid, MeshSolid) else None


def surface_distances(
    mesh: MeshSolid,
    origins: Float[np.ndarray, "ray 3"],
    directions: Float[np.ndarray, "ray 3"],
    depth: Float[np.ndarray, "ray"],
    allowed: Float[np.ndarray, "ray"],
) -> Float[np.ndarray, "ray"]:
    """Distance of the point at a depth along each ray from the surface, metres; negative behind the first hit.

    It is measured to the triangle that the ray hits first. Only where that is more than allowed, all triangles are
    searched.
    """
    points = origins + depth[:, None] * directions
    hit, faces = first_hits(mesh, origins, directions)
    distance = np.full(len(depth), np.inf)
    found = faces >= 0
    distance[found] = mesh.distance_to(faces[found], points[found])
    far = distance > allowed
    distance[far] = mesh.distance(points[far])
    return np.where(depth > hit, -distance, distance)


def bounds(
    mesh: MeshSolid,
    origins: Float[np.ndarray, "ray 3"],
    directions: Float[np.ndarray, "ray 3"],
    sideways: Float[np.ndarray, "ray"],
) -> tuple[Float[np.ndarray, "ray"], Float[np.ndarray, "ray"]]:
    """Find where rays possibly and surely meet a mesh, if it may have moved sideways by some metres.

    Returns:
        Position of the nearest hit among the ray and its neighbours, inf if all of them miss.
        Position of the farthest of their hits, inf if one of them misses.
    """
    across = _across(directions)
    first, _ = first_hits(mesh, origins, directions)
    last = first
    for side in _SIDES:
        moved = origins + (sideways + MARGIN)[:, None] * (side @ across)
        other, _ = first_hits(mesh, moved, directions)
        first, last = np.minimum(first, other), np.maximum(last, other)
    return first, last


def grazes(
    mesh: MeshSolid,
    origins: Float[np.ndarray, "ray 3"],
    directions: Float[np.ndarray, "ray 3"],
    sideways: Float[np.ndarray, "ray"],
) -> Bool[np.ndarray, "ray"]:
    """Whether rays pass so near an outline that a renderer which moves corners sideways may show either side."""
    first, last = bounds(mesh, origins, directions, sideways)
    return np.isinf(last) & np.isfinite(first)


def surface_normals(
    mesh: MeshSolid, points: Float[np.ndarray, "point 3"], directions: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point 3"]:
    """Unit normals of the triangles on which points lie, found along their lines of sight; zeros if there are none.

    Normals of closed meshes point outwards. Surfaces with holes have two sides: their normals face the camera.
    """
    unit = directions / np.sqrt(np.sum(directions**2, axis=1, keepdims=True))
    hit, faces = first_hits(mesh, points - SEARCH * unit, unit)
    found = hit <= 2 * SEARCH
    a, b, c = (mesh.triangles[faces[found], i] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.sqrt(np.sum(normal**2, axis=1, keepdims=True)), 1e-300)
    if not mesh.closed:
        normal *= -np.sign(np.sum(normal * unit[found], axis=1, keepdims=True))
    normals = np.zeros_like(points)
    normals[found] = normal
    return normals


def _across(directions: Float[np.ndarray, "ray 3"]) -> Float[np.ndarray, "ray 2 3"]:
    """Two unit vectors at right angles to each ray and each other."""
    unit = directions / np.sqrt(np.sum(directions**2, axis=1, keepdims=True))
    helper = np.eye(3)[np.argmin(np.abs(unit), axis=1)]
    first = np.cross(unit, helper)
    first /= np.sqrt(np.sum(first**2, axis=1, keepdims=True))
    return np.stack([first, np.cross(unit, first)], axis=1)
