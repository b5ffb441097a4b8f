"""Decide which points a camera sees, by sphere tracing of exact solids and ray casting of meshes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from datagen.shapes.shape import Shape
from datagen.verify import mesh_rays
from datagen.verify.pixels import NEAR_MISS, SHELL
from datagen.verify.scene_case import Case
from datagen.verify.sphere_tracing import clip_to_box, trace

LAST = 1e-3
"""Metres of depth before a point in which it is not decided whether something hides it."""

CLOSE = 3e-3
"""Metres to the surface of another object within which a point may count as hidden or not."""

FACING = 0.1
"""Cosine between surface and line of sight below which an object's own surface may hide a point or not."""

FAR = 20.0
"""Depth to which rays to the backdrop are traced, metres."""


@dataclass(frozen=True, eq=False)
class Sight:
    """Points that one image should show or not."""

    frame: int
    view: int
    row: Integer[np.ndarray, "point"]
    """Rows of their objects, -1 for the table and -2 for the backdrop."""
    pixels: Float[np.ndarray, "point 2"]
    z: Float[np.ndarray, "point"]
    """Depth, metres; infinite for the backdrop."""


@dataclass(frozen=True, eq=False)
class Verdicts:
    """Points that are surely shown, and those that are surely hidden; points near an outline are neither."""

    shown: Bool[np.ndarray, "point"]
    hidden: Bool[np.ndarray, "point"]


def judge(case: Case, sights: Sequence[Sight]) -> list[Verdicts]:
    """Decide which points the cameras see, for each sight."""
    lines = _lines(case, sights)
    row, world = np.concatenate([sight.row for sight in sights]), lines.center + lines.depth[:, None] * lines.ray
    shown, hidden = row < 0, np.zeros(len(row), bool)
    # Each object may show its own points and hide others.
    for place, shape in enumerate(case.shapes):
        part = np.flatnonzero((row == place) | _near_box(case, lines, place))
        poses, depth = case.world_from_object[lines.frame[part], place], lines.depth[part]
        origins = np.einsum("pj,pji->pi", lines.center[part] - poses[:, :3, 3], poses[:, :3, :3])
        local = np.einsum("pj,pji->pi", lines.ray[part], poses[:, :3, :3])
        points = origins + depth[:, None] * local
        # A point of its own is shown if its surface clearly faces the camera.
        own = np.flatnonzero(row[part] == place)
        if len(own):
            normal = surface_normals(shape, points[own], local[own])
            length = np.sqrt(np.sum(local[own] ** 2, axis=1))
            shown[part[own]] = np.sum(normal * local[own], axis=1) < -FACING * length
        # A line that surely meets the object hides its point; one that comes near it decides nothing.
        near, far = clip_to_box(shape.minimum_box, origins, local, NEAR_MISS + SHELL)
        some = np.flatnonzero(near < np.minimum(far, depth))
        ends, there = np.minimum(far, depth - LAST), part[some]
        sideways = case.allowed.precision.sideways(depth[some], lines.focal[there])
        if mesh := mesh_rays.mesh_of(shape):
            first, last = mesh_rays.bounds(mesh, origins[some], local[some], NEAR_MISS + sideways)
            met, passed = last < ends[some], first >= ends[some]
        else:
            hit, closest = trace(shape.signed_distance, origins[some], local[some], near[some], ends[some], SHELL)
            met, passed = np.isfinite(hit), closest > NEAR_MISS + sideways
        hidden[there] |= met & (sideways == 0)
        shown[there[~passed]] = False
        # Points of others are undecided close to its surface.
        others = some[(row[there] != place) & shown[there]]
        close = mesh.within(points[others], CLOSE) if mesh else shape.signed_distance(points[others]) <= CLOSE
        shown[part[others[close]]] = False
    # The table hides points below it.
    shown[(world[:, 2] < 0) & (row >= 0)] = False
    hidden |= _below_table(case, lines) & (row != -1)
    ends = np.cumsum([len(sight.row) for sight in sights])[:-1]
    return [Verdicts(*pair) for pair in zip(np.split(shown & ~hidden, ends), np.split(hidden, ends), strict=True)]


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines of sight from cameras to points."""

    frame: Integer[np.ndarray, "point"]
    center: Float[np.ndarray, "point 3"]
    ray: Float[np.ndarray, "point 3"]
    """Direction per unit of depth, world frame."""
    depth: Float[np.ndarray, "point"]
    focal: Float[np.ndarray, "point"]


def _lines(case: Case, sights: Sequence[Sight]) -> _Lines:
    rays, centers = [], []
    for sight in sights:
        k, pose = case.record["camera/K"][sight.view], case.at(sight.frame).record["camera/world_from_camera"]
        pixels = np.concatenate([sight.pixels, np.ones((len(sight.pixels), 1))], axis=1)
        rays.append(np.linalg.solve(k, pixels.T).T @ pose[sight.view, :3, :3].T)
        centers.append(np.broadcast_to(pose[sight.view, :3, 3], (len(pixels), 3)))
    counts = [len(sight.row) for sight in sights]
    return _Lines(
        frame=np.repeat([sight.frame for sight in sights], counts),
        center=np.concatenate(centers),
        ray=np.concatenate(rays),
        depth=np.minimum(np.concatenate([sight.z for sight in sights]), FAR),
        focal=np.repeat(case.focal[[sight.view for sight in sights]], counts),
    )


def _near_box(case: Case, lines: _Lines, place: int) -> Bool[np.ndarray, "point"]:
    """Whether lines of sight meet the ball around an object's box; all others miss the box."""
    box, poses = case.shapes[place].minimum_box, case.world_from_object[:, place]
    centers = poses[:, :3, :3] @ box.center + poses[:, :3, 3]
    radius = 0.5 * np.linalg.norm(box.size) + 2 * (NEAR_MISS + SHELL)
    towards = centers[lines.frame] - lines.center
    along, length = (np.einsum("pi,pi->p", lines.ray, other) for other in (towards, lines.ray))
    return np.einsum("pi,pi->p", towards, towards) - along**2 / length < radius**2


CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float64)
"""Corners of a tetrahedron, whose weighted sum of a function's values is its gradient."""

STEP = 1e-4
"""Half side of the tetrahedron, metres."""


def surface_normals(
    shape: Shape, points: Float[np.ndarray, "point 3"], rays: Float[np.ndarray, "point 3"]
) -> Float[np.ndarray, "point 3"]:
    """Unit normals of a shape at points on its surface, seen along rays, all in the object frame; zeros if unknown."""
    if mesh := mesh_rays.mesh_of(shape):
        return mesh_rays.surface_normals(mesh, points, rays)
    values = [shape.signed_distance(points + STEP * corner) for corner in CORNERS]
    total = np.sum([value[:, None] * corner for value, corner in zip(values, CORNERS, strict=True)], axis=0)
    length = np.sqrt(np.sum(total * total, axis=1, keepdims=True))
    return total / np.where(length > 0, length, 1)


def _below_table(case: Case, lines: _Lines) -> Bool[np.ndarray, "point"]:
    """Whether lines of sight surely meet the table before their points."""
    falls = lines.ray[:, 2] < 0
    meets = -lines.center[:, 2] / np.where(falls, lines.ray[:, 2], -1e-300)
    place = lines.center[:, :2] + meets[:, None] * lines.ray[:, :2]
    on_table = np.max(np.abs(place), axis=1) < 0.5 * case.scene.table.size - CLOSE
    return falls & on_table & (meets < lines.depth - LAST)
