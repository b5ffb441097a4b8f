"""Closed triangle meshes of boxes, prisms and solids of revolution, with as few triangles as the tolerance allows.

Where a surface curves, vertices lie a little outside it and the middles of edges as far inside, which halves the
error of a mesh whose vertices lie on the surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from datagen.shapes.shape import MESH_TOLERANCE, Numbers

CHORD_ERROR = 0.9 * MESH_TOLERANCE
"""Metres by which tessellation may miss a curved surface; the rest is left to rounding."""

CREASE_COSINE = np.cos(np.radians(40))
"""Neighbouring faces that turn by less than 40 degrees share their normals."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with a normal at each corner of each face."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    normals: Float[np.ndarray, "face 3 3"]

    def placed(self, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Mesh":
        """The mesh after `outer = rotation @ local + translation`."""
        return Mesh(self.vertices @ rotation.T + translation, self.faces, self.normals @ rotation.T)


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """All triangles of all meshes."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts[:-1], strict=True)]),
        np.concatenate([mesh.normals for mesh in meshes]),
    )


def unit(vectors: Float[np.ndarray, "*batch axis"]) -> Float[np.ndarray, "*batch axis"]:
    """Normalise vectors along the last axis."""
    return vectors / np.sqrt(np.sum(vectors * vectors, axis=-1, keepdims=True))


def segments_of_circle(radius: float, tolerance: float = CHORD_ERROR, least: int = 12) -> int:
    """Number of chords within `tolerance` of a circle, their ends as far outside it as their middles inside."""
    cosine = (radius - tolerance) / (radius + tolerance)
    return max(least, int(np.ceil(np.pi / np.arccos(cosine)))) if cosine > 0 else least


def balanced(count: int) -> float:
    """Radius of a regular polygon's corners that lie as far outside the unit circle as its sides' middles inside."""
    return 2 / (1 + np.cos(np.pi / count))


def circle(count: int) -> Float[np.ndarray, "corner 2"]:
    """Corners of the regular polygon that stands for the unit circle, the first one on the x axis."""
    angles = 2 * np.pi * np.arange(count) / count
    return balanced(count) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def box(size: Numbers) -> Mesh:
    """A box around the origin: 12 triangles."""
    vertices, faces, normals = _unit_box()
    return Mesh(vertices * np.asarray(size), faces, normals)


def revolution(profile: Float[np.ndarray, "corner 2"]) -> Mesh:
    """The surface that a counter-clockwise polygon (r, z) sweeps about the z axis, without its edges on the axis."""
    steps = segments_of_circle(float(profile[:, 0].max()))
    corners = len(profile)
    ring = np.broadcast_to(circle(steps), (corners, steps, 2)) * profile[:, None, :1]
    vertices = np.concatenate([ring, np.broadcast_to(profile[:, None, 1:], (corners, steps, 1))], axis=2)
    # A corner on the axis is one vertex, and the triangle with two corners there is none.
    at_axis = profile[:, 0] == 0
    index = np.arange(corners * steps).reshape(corners, steps)
    index[at_axis] = index[at_axis, :1]
    a, b = index, np.roll(index, -1, axis=1)
    c, d = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
    lower, upper = ~at_axis, ~np.roll(at_axis, -1)
    start, end, middle = (_turned_normals(profile, steps, share) for share in (0.0, 1.0, 0.5))
    apex_above = np.where(upper[:, None, None], start[1], middle[1])
    apex_below = np.where(lower[:, None, None], end[0], middle[0])
    faces = [np.stack([a, b, c], axis=-1)[lower], np.stack([b, d, c], axis=-1)[upper]]
    normals = [
        np.stack([start[0], end[0], apex_above], axis=-2)[lower],
        np.stack([apex_below, end[1], start[1]], axis=-2)[upper],
    ]
    return _compact(
        vertices.reshape(-1, 3),
        np.concatenate([part.reshape(-1, 3) for part in faces]),
        np.concatenate([part.reshape(-1, 3, 3) for part in normals]),
    )


def lofted(
    ring: Float[np.ndarray, "step 2"],
    profile: Float[np.ndarray, "level 2"],
    normals: Float[np.ndarray, "level step 3"],
) -> Mesh:
    """A closed surface of scaled copies of one ring: point (s, z) of the profile puts the ring times s at height z.

    The ring is a counter-clockwise convex polygon around the origin. Along the profile z rises; s is 0 at both ends.
    """
    levels, steps = normals.shape[:2]
    rows = np.concatenate([profile[:, None, :1] * ring, np.repeat(profile[:, None, 1:], steps, axis=1)], axis=2)
    index = np.arange(levels * steps).reshape(levels, steps)
    index[0], index[-1] = index[0, 0], index[-1, 0]
    after = np.roll(index, -1, axis=1)
    low = np.stack([index[:-1], after[:-1], after[1:]], axis=-1)[1:]
    high = np.stack([index[:-1], after[1:], index[1:]], axis=-1)[:-1]
    faces = np.concatenate([low.reshape(-1, 3), high.reshape(-1, 3)])
    return _compact(rows.reshape(-1, 3), faces, normals.reshape(-1, 3)[faces])


def extrusion(polygon: Float[np.ndarray, "corner 2"], pieces: Sequence[Sequence[int]], height: float) -> Mesh:
    """A prism along z, symmetric about z = 0, over a counter-clockwise polygon with its cut into convex pieces."""
    count = len(polygon)
    half = np.full((count, 1), 0.5 * height)
    vertices = np.concatenate([np.hstack([polygon, half]), np.hstack([polygon, -half])])
    cap = np.array([[p[0], p[i], p[i + 1]] for p in pieces for i in range(1, len(p) - 1)])
    i = np.arange(count)
    k = (i + 1) % count
    at_start, at_end = _profile_normals(polygon)
    start, end = (np.hstack([n, np.zeros((count, 1))]) for n in (at_start, at_end))
    up = np.zeros((len(cap), 3, 3))
    up[..., 2] = 1
    faces = [cap, cap[:, ::-1] + count, np.stack([i + count, k + count, i], 1), np.stack([k + count, k, i], 1)]
    normals = [up, -up, np.stack([start, end, start], 1), np.stack([end, end, start], 1)]
    return Mesh(vertices, np.concatenate(faces), np.concatenate(normals))


@lru_cache(maxsize=1)
def _unit_box() -> tuple[Float[np.ndarray, "8 3"], Int[np.ndarray, "12 3"], Float[np.ndarray, "12 3 3"]]:
    square = np.array([[0.5, 0.5], [-0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
    mesh = extrusion(square, [(0, 1, 2, 3)], 1.0)
    return mesh.vertices, mesh.faces, mesh.normals


def _profile_normals(
    polygon: Float[np.ndarray, "corner 2"],
) -> tuple[Float[np.ndarray, "edge 2"], Float[np.ndarray, "edge 2"]]:
    """Outward normals at start and end of each edge of a counter-clockwise polygon, shared where it is smooth."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    own = unit(np.stack([edges[:, 1], -edges[:, 0]], axis=1))
    before = np.roll(own, 1, axis=0)
    smooth = np.einsum("ij,ij->i", own, before) > CREASE_COSINE
    shared = np.where(smooth[:, None], unit(own + before + 1e-30), own)
    at_start = shared
    at_end = np.roll(np.where(smooth[:, None], shared, before), -1, axis=0)
    return at_start, at_end


def _turned_normals(
    profile: Float[np.ndarray, "corner 2"], steps: int, share: float
) -> Float[np.ndarray, "end corner step 3"]:
    """Normals at both ends of each edge of a profile, turned about z to that share of each step."""
    radial, upward = np.moveaxis(np.stack(_profile_normals(profile)), -1, 0)
    angles = 2 * np.pi * (np.arange(steps) + share) / steps
    turned = np.empty((*radial.shape, steps, 3))
    turned[..., 0] = radial[..., None] * np.cos(angles)
    turned[..., 1] = radial[..., None] * np.sin(angles)
    turned[..., 2] = upward[..., None]
    return turned


def _compact(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> Mesh:
    used = np.zeros(len(vertices), bool)
    used[faces] = True
    return Mesh(vertices[used], (np.cumsum(used) - 1)[faces], normals)


def convex_hull(points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "corner 2"]:
    """Corners of the convex hull, counter-clockwise (Andrew's monotone chain)."""
    ordered = sorted({(float(x), float(y)) for x, y in points})
    return np.array(_half_hull(ordered)[:-1] + _half_hull(ordered[::-1])[:-1])


def _half_hull(ordered: list[tuple[float, float]]) -> list[tuple[float, float]]:
    chain: list[tuple[float, float]] = []
    for x, y in ordered:
        while len(chain) > 1 and (chain[-1][0] - chain[-2][0]) * (y - chain[-2][1]) <= (chain[-1][1] - chain[-2][1]) * (
            x - chain[-2][0]
        ):
            chain.pop()
        chain.append((x, y))
    return chain
