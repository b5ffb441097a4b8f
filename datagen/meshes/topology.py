"""Triangle soups to surfaces: welding, orientation, and whether a surface is closed."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from datagen.meshes.distance import winding_numbers
from datagen.shapes.geometry.mesh import CREASE_COSINE

_WELD = 1e-6
"""Distance, as a share of the longest side, within which corners are one vertex."""

_MOST_PAIRS = 20_000_000
"""Largest number of pairs of faces around vertices that are smoothed; beyond it, faces are flat."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Welded triangles."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    rows: Int[np.ndarray, "face"]
    """Row of each face before welding."""
    turned: Bool[np.ndarray, "face"]
    """Whether the order of a face's corners was reversed."""
    closed: bool
    """Whether every edge is passed as often in one direction as in the other, so that the surface has an inside."""
    bodies: int
    """Number of connected pieces."""
    open_share: float
    """Share of edges that belong to a single face."""


def weld(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Surface:
    """Join equal corners, drop faces without area, and turn closed pieces so that their normals point outwards."""
    size = float(np.max(np.ptp(vertices[faces].reshape(-1, 3), axis=0)))
    keys = np.round(vertices / max(size * _WELD, 1e-300)).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    welded = index.reshape(-1)[faces]
    real = np.all(welded != np.roll(welded, -1, axis=1), axis=1)
    points, welded = _used(vertices[first], welded[real])
    pieces, labels = _pieces(len(points), welded)
    face_labels = labels[welded[:, 0]]
    turned = np.zeros(len(welded), bool)
    for piece in range(pieces):
        rows = face_labels == piece
        if is_closed(welded[rows]) and signed_volume(points, welded[rows]) < 0:
            # The wall of a cavity points inwards, and stays.
            others = welded[~rows]
            corner = points[welded[rows][:1, 0]]
            if not len(others) or winding_numbers(points[others], corner)[0] < 0.5:
                turned[rows] = True
    welded[turned] = welded[turned][:, ::-1]
    return Surface(points, welded, np.flatnonzero(real), turned, is_closed(welded), pieces, _open_edges(welded))


def is_closed(faces: Int[np.ndarray, "face 3"]) -> bool:
    """Whether every edge is passed as often in one direction as in the other."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    _, edge = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True)
    return not np.any(np.bincount(edge.reshape(-1), weights=np.where(start < end, 1.0, -1.0)))


def signed_volume(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> float:
    """Volume of a closed surface; negative if its normals point inwards."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float(np.sum(np.cross(a, b) * c) / 6)


def smooth_normals(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "face 3 3"]:
    """Unit normals at the corners of each face: means of the faces around that turn by less than 40 degrees."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    length = np.sqrt(np.sum(across**2, axis=1, keepdims=True))
    own = across / np.where(length > 0, length, 1)
    normals = np.repeat(own[:, None], 3, axis=1)
    corners = faces.ravel()
    order = np.argsort(corners, kind="stable")
    count = np.bincount(corners, minlength=len(vertices))
    if np.sum(count.astype(float) ** 2) > _MOST_PAIRS:
        return normals
    # All pairs of corners at the same vertex.
    start = np.cumsum(count) - count
    repeats = count[corners[order]]
    first = np.repeat(order, repeats)
    offset = np.arange(len(first)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    second = order[np.repeat(start[corners[order]], repeats) + offset]
    near = np.sum(own[first // 3] * own[second // 3], axis=1) > CREASE_COSINE
    total = np.zeros((len(corners), 3))
    np.add.at(total, first[near], across[second[near] // 3])
    size = np.sqrt(np.sum(total**2, axis=1, keepdims=True))
    return np.where(size > 0, total / np.where(size > 0, size, 1), normals.reshape(-1, 3)).reshape(-1, 3, 3)


def _used(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used = np.zeros(len(points), bool)
    used[faces] = True
    return points[used], (np.cumsum(used) - 1)[faces]


def _pieces(vertices: int, faces: np.ndarray) -> tuple[int, np.ndarray]:
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    graph = coo_array((np.ones(len(start), bool), (start, end)), shape=(vertices, vertices))
    count, labels = connected_components(graph, directed=False)
    return int(count), labels


def _open_edges(faces: np.ndarray) -> float:
    edges = np.sort(np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], axis=1), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    return float(np.mean(count == 1)) if len(count) else 1.0
