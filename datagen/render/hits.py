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
from datagen.render import kernels
from datagen.render.kernels import NEAR, SUB, kernel
from datagen.scene import Camera
from datagen.shapes.shape import Shape

TILE = 12
"""Side of the squares of the image that list the triangles in them, samples; a pixel has 3x3 samples."""

REACH = 1.5
"""Distance in samples to which the nearest triangle is used where a renderer draws an object beside its triangles."""

ANY = -1
"""Owner of points that may lie on any object."""


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
        self._starts, self._items = _list_faces(*places, meshes.faces, self._columns, self._rows)

    def hit(self, points: Float[np.ndarray, "point 2"], owners: Int[np.ndarray, "point"]) -> Hits:
        """First surfaces behind points of the image (pixels), of the object in row `owners`, or of all for `ANY`.

        A point of a certain object that lies up to half a pixel beside all its triangles gets the nearest one.
        """
        count = len(points)
        hits = Hits(np.full(count, -1, np.int32), np.zeros((count, 3)), np.zeros(count))
        _hit(
            np.ascontiguousarray(SUB * points, np.float64),
            np.ascontiguousarray(owners, np.int32),
            self._homogeneous,
            self._screen,
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
        low = np.clip(np.floor(np.min(corners, axis=0) / SUB), 0, self._size).astype(int)
        high = np.clip(np.ceil(np.max(corners, axis=0) / SUB), 0, self._size).astype(int)
        x, y = (grid.ravel() for grid in np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])))
        inside = _inside(
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


@kernel
def _list_faces(homogeneous, screen, faces, tiles_x, tiles_y):
    """Triangles that face the camera by the tiles that they may touch: `items[starts[t] : starts[t + 1]]`."""
    spans = np.zeros((len(faces), 4), np.int64)
    starts = np.zeros(tiles_x * tiles_y + 1, np.int64)
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        spans[f, 0] = 1  # an empty span
        if not (homogeneous[i, 2] > NEAR and homogeneous[j, 2] > NEAR and homogeneous[k, 2] > NEAR):
            continue  # Scenes keep everything in view beyond NEAR.
        xi, xj, xk = screen[i, 0], screen[j, 0], screen[k, 0]
        yi, yj, yk = screen[i, 1], screen[j, 1], screen[k, 1]
        if (xj - xi) * (yk - yi) - (yj - yi) * (xk - xi) >= 0:
            continue
        x0, x1 = min(xi, min(xj, xk)) - REACH, max(xi, max(xj, xk)) + REACH
        y0, y1 = min(yi, min(yj, yk)) - REACH, max(yi, max(yj, yk)) + REACH
        if x1 < 0 or y1 < 0 or x0 >= tiles_x * TILE or y0 >= tiles_y * TILE:
            continue
        spans[f, 0], spans[f, 1] = max(int(x0 / TILE), 0), min(int(x1 / TILE), tiles_x - 1)
        spans[f, 2], spans[f, 3] = max(int(y0 / TILE), 0), min(int(y1 / TILE), tiles_y - 1)
        for y in range(spans[f, 2], spans[f, 3] + 1):
            for x in range(spans[f, 0], spans[f, 1] + 1):
                starts[y * tiles_x + x + 1] += 1
    for t in range(len(starts) - 1):
        starts[t + 1] += starts[t]
    items, filled = np.empty(starts[-1], np.int32), starts[:-1].copy()
    for f in range(len(faces)):
        for y in range(spans[f, 2], spans[f, 3] + 1):
            for x in range(spans[f, 0], spans[f, 1] + 1):
                items[filled[y * tiles_x + x]] = f
                filled[y * tiles_x + x] += 1
    return starts, items


@kernel
def _edges(homogeneous, i, j, k):
    """Coefficients of a triangle's edge functions and its determinant, see `kernels.rasterise`."""
    qix, qiy, zi = homogeneous[i, 0], homogeneous[i, 1], homogeneous[i, 2]
    qjx, qjy, zj = homogeneous[j, 0], homogeneous[j, 1], homogeneous[j, 2]
    qkx, qky, zk = homogeneous[k, 0], homogeneous[k, 1], homogeneous[k, 2]
    ax, ay, az = qjy * zk - zj * qky, zj * qkx - qjx * zk, qjx * qky - qjy * qkx
    bx, by, bz = qky * zi - zk * qiy, zk * qix - qkx * zi, qkx * qiy - qky * qix
    cx, cy, cz = qiy * zj - zi * qjy, zi * qjx - qix * zj, qix * qjy - qiy * qjx
    return ax, ay, az, bx, by, bz, cx, cy, cz, qix * ax + qiy * ay + zi * az


@kernel
def _hit(
    points, owners, homogeneous, screen, faces, face_owners, starts, items, tiles_x, tiles_y, face, weights, inverse
):
    """Fill `face`, `weights` and `inverse`; see `Hits`."""
    for p in range(len(points)):
        sx, sy = points[p, 0], points[p, 1]
        if not (sx >= 0 and sy >= 0 and sx < tiles_x * TILE and sy < tiles_y * TILE):
            continue
        tile = int(sy / TILE) * tiles_x + int(sx / TILE)
        best, nearest = 0.0, REACH
        for item in range(starts[tile], starts[tile + 1]):
            f = items[item]
            if owners[p] != ANY and face_owners[f] != owners[p]:
                continue
            ax, ay, az, bx, by, bz, cx, cy, cz, det = _edges(homogeneous, faces[f, 0], faces[f, 1], faces[f, 2])
            if det >= 0:
                continue
            a, b, c = ax * sx + (ay * sy + az), bx * sx + (by * sy + bz), cx * sx + (cy * sy + cz)
            depth = (a + b + c) * (1 / det)
            if a > 0 or b > 0 or c > 0:
                if owners[p] == ANY or best > 0:
                    continue
                # Beside the triangle: keep the nearest one in case that the point lies beside all of them.
                outside = max(
                    a / np.sqrt(ax * ax + ay * ay),
                    max(b / np.sqrt(bx * bx + by * by), c / np.sqrt(cx * cx + cy * cy)),
                )
                if outside >= nearest:
                    continue
                nearest = outside
                a, b, c = min(a, 0.0), min(b, 0.0), min(c, 0.0)
            elif depth > best:
                best = depth
            else:
                continue
            total = a + b + c
            face[p], inverse[p] = f, total * (1 / det)
            weights[p, 0], weights[p, 1], weights[p, 2] = a / total, b / total, c / total


@kernel
def _inside(points, row, homogeneous, faces, face_owners, starts, items, tiles_x):
    """Whether a triangle of one object covers each point."""
    inside = np.zeros(len(points), np.bool_)
    for p in range(len(points)):
        sx, sy = points[p, 0], points[p, 1]
        tile = int(sy / TILE) * tiles_x + int(sx / TILE)
        for item in range(starts[tile], starts[tile + 1]):
            f = items[item]
            if face_owners[f] != row:
                continue
            ax, ay, az, bx, by, bz, cx, cy, cz, det = _edges(homogeneous, faces[f, 0], faces[f, 1], faces[f, 2])
            if det >= 0:
                continue
            a, b, c = ax * sx + (ay * sy + az), bx * sx + (by * sy + bz), cx * sx + (cy * sy + cz)
            if not (a > 0 or b > 0 or c > 0):
                inside[p] = True
                break
    return inside
