"""Meshes of surfaces that curve in two directions: ellipsoids, capsules, tori."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from datagen.geometry import cross
from datagen.shapes.geometry.mesh import CHORD_ERROR, Mesh, segments_of_circle, unit
from datagen.shapes.shape import Numbers


def ellipsoid(half_axes: Numbers, tolerance: float = CHORD_ERROR) -> Mesh:
    """An ellipsoid around the origin; a stretched unit sphere, whose error grows no faster than its longest axis."""
    axes = np.asarray(half_axes, float)
    directions, faces, inner = _fine_enough_dome(float(axes.max()), tolerance)
    normals = unit(directions / axes)
    return Mesh(directions * (axes * (2 / (1 + inner))), faces, normals[faces])


def capsule(radius: float, length: float) -> Mesh:
    """Half spheres around z = -length/2 and z = length/2 and the cylinder between them."""
    directions, faces, inner = _fine_enough_dome(radius)
    upper = np.flatnonzero(directions[:, 2] > -1e-9)
    lower = np.flatnonzero(directions[:, 2] < 1e-9)
    position = np.full((2, len(directions)), -1)
    position[0, upper] = np.arange(len(upper))
    position[1, lower] = len(upper) + np.arange(len(lower))
    is_upper = directions[faces, 2].min(axis=1) > -1e-9
    ring = np.flatnonzero(np.abs(directions[:, 2]) < 1e-9)
    a, b = position[0, ring], position[1, ring]
    c, d = np.roll(a, -1), np.roll(b, -1)
    sides = np.concatenate([np.stack([b, d, a], axis=1), np.stack([d, c, a], axis=1)])
    faces = np.concatenate([position[0, faces[is_upper]], position[1, faces[~is_upper]], sides])
    normals = np.concatenate([directions[upper], directions[lower]])
    vertices = normals * (radius * 2 / (1 + inner))
    vertices[:, 2] += np.where(np.arange(len(vertices)) < len(upper), 0.5, -0.5) * length
    return Mesh(vertices, faces, normals[faces])


def torus(ring_radius: float, tube_radius: float) -> Mesh:
    """A torus about the z axis of nearly equilateral triangles; every other ring is turned by half a step."""
    # Equilateral triangles of side s, measured in units that make both curvatures 1, are off by s^2 / 6, a chord as
    # long as the side by 3/4 of that and one as long as the height by 9/16.
    around = 2 * ((segments_of_circle(ring_radius + tube_radius, 9 / 16 * CHORD_ERROR) + 1) // 2)
    tube = segments_of_circle(tube_radius, 3 / 4 * CHORD_ERROR)
    i, j = np.meshgrid(np.arange(around), np.arange(tube), indexing="ij")
    turn, tilt = 2 * np.pi * i / around, 2 * np.pi * (j + 0.5 * (i % 2)) / tube
    radial = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    normals = np.cos(tilt)[..., None] * radial
    normals[..., 2] = np.sin(tilt)
    # Towards the axis the surface is a saddle, whose triangles need less shift to lie half outside, half inside.
    shift = CHORD_ERROR * (0.75 + 0.25 * np.cos(tilt))[..., None]
    vertices = ring_radius * radial + (tube_radius + shift) * normals
    index = i * tube + j
    a, c = index, np.roll(index, -1, axis=1)
    b, d = np.roll(a, -1, axis=0), np.roll(c, -1, axis=0)
    # The next column lies half a step higher than an even one and lower than an odd one.
    even = (i % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, c], axis=-1), np.stack([a, b, d], axis=-1))
    second = np.where(even, np.stack([c, b, d], axis=-1), np.stack([a, d, c], axis=-1))
    faces = np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)])
    return Mesh(vertices.reshape(-1, 3), faces, normals.reshape(-1, 3)[faces])


@lru_cache(maxsize=64)
def unit_dome(order: int) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"], float]:
    """Unit sphere of rings with 5, 10 .. 5*order, .. 10, 5 points between two poles, its equator at z = 0.

    Also gives the radius of the largest ball around the origin inside the mesh.
    """
    upper = [np.array([[0.0, 0.0, 1.0]])]
    for ring in range(1, order + 1):
        # Rings a little denser at the poles make the largest triangles smaller.
        polar = 0.5 * np.pi * (ring / order) * (0.85 + 0.15 * ring / order)
        angles = 2 * np.pi * np.arange(5 * ring) / (5 * ring)
        z = np.full_like(angles, np.cos(polar) if ring < order else 0.0)
        upper.append(np.stack([np.sin(polar) * np.cos(angles), np.sin(polar) * np.sin(angles), z], axis=1))
    vertices = np.concatenate(upper)
    faces = np.array([face for ring in range(1, order + 1) for face in _dome_ring(ring)])
    inner = 1 + 5 * order * (order - 1) // 2
    below = np.where(
        np.arange(len(vertices)) < inner, np.arange(len(vertices)) + len(vertices), np.arange(len(vertices))
    )
    faces = np.concatenate([faces, below[faces[:, ::-1]]])
    vertices = np.concatenate([vertices, vertices[:inner] * np.array([1.0, 1.0, -1.0])])
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return vertices, faces, float(np.einsum("ij,ij->i", a, unit(cross(b - a, c - a))).min())


def _dome_ring(ring: int) -> list[tuple[int, int, int]]:
    def inside(sector: int, step: int) -> int:
        if ring == 1:
            return 0
        return 1 + 5 * (ring - 1) * (ring - 2) // 2 + (sector * (ring - 1) + step) % (5 * (ring - 1))

    def outside(sector: int, step: int) -> int:
        return 1 + 5 * ring * (ring - 1) // 2 + (sector * ring + step) % (5 * ring)

    upward = [(inside(s, k), outside(s, k), outside(s, k + 1)) for s in range(5) for k in range(ring)]
    downward = [(inside(s, k), outside(s, k + 1), inside(s, k + 1)) for s in range(5) for k in range(ring - 1)]
    return upward + downward


def _fine_enough_dome(
    radius: float, tolerance: float = CHORD_ERROR
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"], float]:
    order = 2
    while radius * (1 - unit_dome(order)[2]) > tolerance * (1 + unit_dome(order)[2]):
        order += 1
    return unit_dome(order)
