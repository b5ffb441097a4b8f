"""Pixels of meshes: distances to the triangles themselves, by ray casting instead of sphere tracing."""

import numpy as np
from jaxtyping import Bool, Float

from datagen.meshes.distance import MeshSolid
from datagen.meshes.raycast import first_hits
from datagen.shapes.shape import Shape

MARGIN = 5e-6
"""Metres by which rays are moved sideways to find the pixels at an outline, where rounding decides what they show."""

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
) -> tuple[Float[np.ndarray, "ray"], Bool[np.ndarray, "ray"]]:
    """Find what rays surely and possibly meet, if the mesh may have moved sideways by some metres.

    Returns:
        Position of the farthest hit among the ray and its neighbours, inf if one of them misses.
        Whether any of them hits.
    """
    across = _across(directions)
    hit, _ = first_hits(mesh, origins, directions)
    last, any_hit = hit, np.isfinite(hit)
    for side in _SIDES:
        moved = origins + (sideways + MARGIN)[:, None] * (side @ across)
        other, _ = first_hits(mesh, moved, directions)
        last, any_hit = np.maximum(last, other), any_hit | np.isfinite(other)
    return last, any_hit


def grazes(
    mesh: MeshSolid,
    origins: Float[np.ndarray, "ray 3"],
    directions: Float[np.ndarray, "ray 3"],
    sideways: Float[np.ndarray, "ray"],
) -> Bool[np.ndarray, "ray"]:
    """Whether rays pass so near an outline that a renderer which moves corners sideways may show either side."""
    last, any_hit = bounds(mesh, origins, directions, sideways)
    return np.isinf(last) & any_hit


def _across(directions: Float[np.ndarray, "ray 3"]) -> Float[np.ndarray, "ray 2 3"]:
    """Two unit vectors at right angles to each ray and each other."""
    unit = directions / np.sqrt(np.sum(directions**2, axis=1, keepdims=True))
    helper = np.eye(3)[np.argmin(np.abs(unit), axis=1)]
    first = np.cross(unit, helper)
    first /= np.sqrt(np.sum(first**2, axis=1, keepdims=True))
    return np.stack([first, np.cross(unit, first)], axis=1)
