"""Exact points of the rendered meshes behind any point of an image, with the rasteriser's arithmetic.

The renderers return depth and ids. Signals also need the triangle behind a pixel, the surface behind points that are no
pixel centres, and surfaces that other objects hide. At pixel centres, the tests here are those of `kernels.rasterise`,
so that both cover the same pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int, Int32

from datagen.geometry import invert_rigid
from datagen.render import hit_kernels, kernels
from datagen.render.hit_kernels import ANY, TILE
from datagen.render.kernels import NEAR, SUB
from datagen.scene import Camera
from datagen.shapes.shape import Shape

__all__ = ["ANY", "Hits", "Meshes", "Projection", "pack_meshes"]


@dataclass(frozen=True, eq=False)
class Hits:
    """First surface of a mesh behind each of some points of an image."""

    face: Int32[np.ndarray, "point"]
    """Index of the triangle, -1 if there is none."""
    weights: Float64[np.ndarray, "point 3"]
    """Weights of the triangle's corners, which sum to one; zeros if there is none."""
    inverse_depth: Float64[np.ndarray, "point"]
    """One over the planar depth, 1/m; 0 if there is none."""


@dataclass(frozen=True, eq=False)
class Meshes:
    """Meshes of all objects of a scene, concatenated; each in its object frame."""

    vertices: Float64[np.ndarray, "vertex 3"]
    vertex_start: Int[np.ndarray, "_"]
    faces: Int32[np.ndarray, "face 3"]
    owners: Int32[np.ndarray, "face"]
    """Row of the object that each triangle belongs to."""
    normals: Float64[np.ndarray, "face 3 3"]
    """Normals at the corners of each triangle."""


def pack_meshes(shapes: Sequence[Shape]) -> Meshes:
    """Concatenate the meshes of some shapes."""
    start = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    faces = [np.zeros((0, 3), np.int32)]
    faces += [(shape.faces + first).astype(np.int32) for shape, first in zip(shapes, start, strict=False)]
    return Meshes(
        vertices=np.concatenate([np.zeros((0, 3)), *(shape.vertices for shape in shapes)]),
        vertex_start=start,
        faces=np.concatenate(faces),
        owners=np.repeat(np.arange(len(shapes)), [len(shape.faces) for shape in shapes]).astype(np.int32),
        normals=np.concatenate([np.zeros((0, 3, 3)), *(shape.normals for shape in shapes)]),
    )


class Projection:
    """Meshes at given poses before a camera, ready to be hit."""

    def __init__(
        self,
        meshes: Meshes,
        world_from_object: Float[np.ndarray, "object 4 4"],
        camera: Camera,
        width: int,
        height: int,
    ):
        self._meshes, self._size = meshes, np.array([width, height])
        count = len(meshes.vertices)
        world, self._homogeneous, self._screen = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 2))
        k = camera.k(width, height)
        k[:2] *= SUB
        kernels.place_vertices(meshes.vertices, meshes.vertex_start, np.ascontiguousarray(world_from_object), world)
        samples_from_world = k @ invert_rigid(camera.world_from_camera)[:3]
        kernels.project_vertices(world, samples_from_world, self._homogeneous, self._screen)
        self._columns, self._rows = -(-SUB * width // TILE), -(-SUB * height // TILE)
        places = self._homogeneous, self._screen
        self._starts, self._items = hit_kernels.list_faces(*places, meshes.faces, self._columns, self._rows)

    def hit(self, points: Float[np.ndarray, "point 2"], owners: Int[np.ndarray, "point"]) -> Hits:
        """First surfaces behind points of the image (pixels), of the object in row `owners`, or of all for `ANY`.

        A point of a certain object that lies up to half a pixel beside all its triangles gets the nearest one.
        """
        count = len(points)
        hits = Hits(np.full(count, -1, np.int32), np.zeros((count, 3)), np.zeros(count))
        hit_kernels.hit(
            np.ascontiguousarray(SUB * points, np.float64),
            np.ascontiguousarray(owners, np.int32),
            self._homogeneous,
            self._meshes.faces,
            self._meshes.owners,
            self._starts,
            self._items,
            self._columns,
            self._rows,
            hits.face,
            hits.weights,
            hits.inverse_depth,
        )
        return hits

    def covered(self, row: int) -> tuple[Int[np.ndarray, "pixel"], Int[np.ndarray, "pixel"]]:
        """Rows and columns of the pixels whose centres one object covers, whatever hides it."""
        own = self._meshes.faces[self._meshes.owners == row]
        corners = self._screen[own.ravel()][self._homogeneous[own.ravel(), 2] > NEAR]
        if not len(corners):
            return np.zeros(0, int), np.zeros(0, int)
        # Centres of the pixels in the box around the object.
        low = np.clip(np.floor(np.min(corners, axis=0) / SUB), 0, self._size).astype(int)
        high = np.clip(np.ceil(np.max(corners, axis=0) / SUB), 0, self._size).astype(int)
        x, y = (grid.ravel() for grid in np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])))
        inside = hit_kernels.inside(
            np.stack([SUB * x + 0.5 * SUB, SUB * y + 0.5 * SUB], axis=-1).astype(np.float64),
            row,
            self._homogeneous,
            self._meshes.faces,
            self._meshes.owners,
            self._starts,
            self._items,
            self._columns,
        )
        return y[inside], x[inside]
