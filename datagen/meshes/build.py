"""Build the `Shape` of a mesh: welded surface, mass, resting positions, symmetry, colours."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError

from datagen.meshes.distance import MeshSolid
from datagen.meshes.hulls import convex_corners
from datagen.meshes.named_files import BadMesh
from datagen.meshes.read import RawMesh
from datagen.meshes.skins import make_skin, reordered
from datagen.meshes.topology import Surface, signed_volume, smooth_normals, weld
from datagen.meshes.units import Up, rotation_to_z
from datagen.shapes.geometry.bounding import Outline, minimum_box
from datagen.shapes.geometry.mass import Mass, of_mesh, total
from datagen.shapes.shape import Shape
from datagen.shapes.symmetry import about_z

MOST_OPEN = 0.3
"""Share of open edges from which on triangles form no surface."""

_FLATTEST = 1e-4
"""Share of its longest side that a mesh must be thick at least."""


@dataclass(frozen=True, eq=False)
class Placed:
    """A mesh in metres with z up, around the origin of its file."""

    raw: RawMesh
    surface: Surface
    """Welded surface; vertices in metres."""


def place(raw: RawMesh, scale: float, up: Up, name: str) -> Placed:
    """Scale, turn and weld a mesh; `name` begins error messages.

    Raises:
        BadMesh: the triangles form no surface, or a flat one.
    """
    vertices = scale * raw.vertices @ rotation_to_z(up).T
    longest = float(np.max(np.ptp(vertices[raw.faces].reshape(-1, 3), axis=0)))
    if longest <= 0:
        raise BadMesh(f"{name} is a single point. Export it again, or remove it.")
    surface = weld(vertices, raw.faces)
    if surface.open_share > MOST_OPEN:
        raise BadMesh(
            f"{name} is no surface but loose triangles: {100 * surface.open_share:.0f} % of its edges belong to one "
            f"triangle only, expected at most {100 * MOST_OPEN:.0f} %. Join its vertices, or remove it."
        )
    try:
        hull = ConvexHull(surface.vertices)
    except (QhullError, ValueError):
        hull = None
    if hull is None or hull.volume < _FLATTEST * longest * longest * longest:
        raise BadMesh(f"{name} is flat; expected a solid object. Give it a thickness, or remove it.")
    return Placed(raw, surface)


def mass_of(surface: Surface, hulls: tuple[Float[np.ndarray, "_ 3"], ...]) -> Mass:
    """Mass from the closed surface, otherwise from the hulls."""
    if surface.closed and signed_volume(surface.vertices, surface.faces) > 0:
        return of_mesh(surface.vertices, surface.faces)
    return total([of_mesh(*_triangulated(part)) for part in hulls])


def make_shape(placed: Placed, mass: Mass, hulls: tuple[Float[np.ndarray, "_ 3"], ...]) -> Shape:
    """The shape around its centre of mass.

    Open surfaces are drawn from both sides: their faces appear a second time in reverse order.
    """
    surface = placed.surface
    # Surface about the centre of mass.
    vertices, faces = surface.vertices - mass.center, surface.faces
    normals, rows, turned = smooth_normals(vertices, faces), surface.rows, surface.turned
    solid = MeshSolid(vertices, faces, closed=surface.closed)
    if not surface.closed:
        faces, rows = np.concatenate([faces, faces[:, ::-1]]), np.concatenate([rows, rows])
        normals, turned = np.concatenate([normals, -normals[:, ::-1]]), np.concatenate([turned, ~turned])
    # Outline, colours and parts for the simulation.
    corners = convex_corners(vertices)
    skin = make_skin(placed.raw, surface_vertices(placed)) if placed.raw.has_colors else None
    parts = tuple(part - mass.center for part in hulls)
    return Shape(
        vertices=vertices,
        faces=faces,
        normals=normals,
        solids=(solid,),
        convex_parts=parts,
        volume=mass.volume,
        inertia=mass.inertia,
        symmetry=find_symmetry(vertices, solid),
        minimum_box=minimum_box(Outline.of_points(corners)),
        size=np.ptp(vertices, axis=0),
        backs=0 if surface.closed else len(surface.faces),
        skin=reordered(skin, rows, turned) if skin else None,
        resting=resting_directions(np.concatenate(parts)) if parts else (),
    )


def surface_vertices(placed: Placed) -> Float[np.ndarray, "vertex 3"]:
    """Vertices of the file, before welding, at the scale of the surface."""
    scale = float(np.max(np.ptp(placed.surface.vertices, axis=0)))
    own = float(np.max(np.ptp(placed.raw.vertices[placed.raw.faces].reshape(-1, 3), axis=0)))
    return placed.raw.vertices * (scale / own)


def resting_directions(corners: Float[np.ndarray, "corner 3"]) -> tuple[tuple[float, float, float], ...]:
    """Directions (object frame) in which the outward normals of the hull's facets point, one for equal normals."""
    equations = ConvexHull(corners).equations[:, :3]
    kept: list[np.ndarray] = []
    for normal in equations:
        if all(normal @ other < 0.9998 for other in kept):
            kept.append(normal)
    return tuple((float(x), float(y), float(z)) for x, y, z in kept)


def _triangulated(part: Float[np.ndarray, "corner 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Corners and outward triangles of a convex hull."""
    hull = ConvexHull(part)
    faces = hull.simplices.copy()
    a, b, c = (hull.points[faces[:, i]] for i in range(3))
    inward = np.sum(np.cross(b - a, c - a) * hull.equations[:, :3], axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return hull.points, faces


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
