"""Parts that shapes are assembled from, each a solid with its mesh, convex hulls, mass and outline."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from datagen.geometry import cross
from datagen.shapes.geometry import mass as masses
from datagen.shapes.geometry import mesh as meshes
from datagen.shapes.geometry import round_mesh, sdf
from datagen.shapes.geometry.bounding import Outline, minimum_box
from datagen.shapes.geometry.mass import Mass
from datagen.shapes.geometry.mesh import Mesh, convex_hull
from datagen.shapes.shape import Corners, Numbers, Primitive, Shape, Solid

HULL_ERROR = 5e-4
"""Metres by which the corners of a curved part's convex hull may miss it."""


@dataclass(frozen=True, eq=False)
class Part:
    """A solid with its mesh, hulls, mass and outline, in one frame."""

    solid: Solid
    mesh: Mesh
    hulls: tuple[Float[np.ndarray, "_ 3"], ...]
    """Corners of convex pieces that cover the solid."""
    mass: Mass
    outline: Outline
    primitive: Primitive | None = None
    """Primitive that equals the solid exactly; None if there is none."""

    def placed(self, translation: Numbers, rotation: Float[np.ndarray, "3 3"] | None = None) -> "Part":
        """The part turned, then moved."""
        turn = np.eye(3) if rotation is None else rotation
        shift = np.asarray(translation, float)
        return Part(
            sdf.Placed(self.solid, turn, shift),
            self.mesh.placed(turn, shift),
            tuple(hull @ turn.T + shift for hull in self.hulls),
            self.mass.placed(turn, shift),
            self.outline.placed(turn, shift),
        )


def assemble(parts: Sequence[Part], symmetry: str, *, overlap: Sequence[Mass] = (), aligned: bool = False) -> Shape:
    """The union of parts in one frame as a shape around its centre of mass.

    Parts touch at most, except for the intersections in `overlap`. `symmetry` is the exact rotation group about the
    centre of mass; `aligned` means that the smallest box is known to have its sides along the axes.
    """
    mass = masses.total([part.mass for part in parts] + [common.negative() for common in overlap])
    moved = parts if not np.any(mass.center) else [part.placed(-mass.center) for part in parts]
    mesh = meshes.merge([part.mesh for part in moved])
    outline = Outline.union([part.outline for part in moved])
    low, high = outline.span(np.eye(3))
    return Shape(
        vertices=mesh.vertices,
        faces=mesh.faces,
        normals=mesh.normals,
        solids=tuple(part.solid for part in moved),
        convex_parts=tuple(hull for part in moved for hull in part.hulls),
        volume=mass.volume,
        inertia=mass.inertia,
        symmetry=symmetry,
        minimum_box=minimum_box(outline, aligned=aligned),
        size=high - low,
        primitive=moved[0].primitive if len(moved) == 1 else None,
    )


def box(size: Numbers) -> Part:
    """A box around the origin."""
    mesh = meshes.box(size)
    x, y, z = (float(length) for length in size)
    solid = sdf.Box((x, y, z))
    return Part(
        solid, mesh, (mesh.vertices,), masses.of_box(size), Outline.of_points(mesh.vertices), ("box", (x, y, z))
    )


def slab(x: Numbers, y: Numbers, z: Numbers) -> Part:
    """The box between the given least and greatest coordinates."""
    low, high = np.array([x, y, z], float).T
    return box(high - low).placed(0.5 * (low + high))


def sphere(radius: float) -> Part:
    """A ball around the origin."""
    part = ellipsoid((radius, radius, radius))
    return replace(part, solid=sdf.Sphere(radius), primitive=("sphere", (radius,)))


def ellipsoid(half_axes: Numbers) -> Part:
    """An ellipsoid around the origin."""
    x, y, z = (float(half) for half in half_axes)
    hull = round_mesh.ellipsoid(half_axes, HULL_ERROR).vertices
    outline = Outline.of_ellipsoid(half_axes)
    return Part(
        sdf.Ellipsoid((x, y, z)), round_mesh.ellipsoid(half_axes), (hull,), masses.of_ellipsoid(half_axes), outline
    )


def capsule(radius: float, length: float) -> Part:
    """All points within `radius` of a piece of the z axis of the given length around the origin."""
    ends = [masses.of_ball_slice(radius, 0.0, radius).placed(np.eye(3), np.array([0, 0, 0.5 * length]))]
    ends.append(ends[0].placed(np.diag([1.0, -1.0, -1.0]), np.zeros(3)))
    half = 0.5 * length
    tube = masses.of_revolution(np.array([[0, -half], [radius, -half], [radius, half], [0, half]]))
    hull = round_mesh.ellipsoid((radius, radius, radius), HULL_ERROR).vertices
    shift = np.array([0, 0, half])
    return Part(
        sdf.Capsule(radius, length),
        round_mesh.capsule(radius, length),
        (np.concatenate([hull[hull[:, 2] > -1e-9] + shift, hull[hull[:, 2] < 1e-9] - shift]),),
        masses.total([*ends, tube]),
        Outline.of_circles(np.zeros(2), np.array([-half, half]), radius),
        ("capsule", (radius, length)),
    )


def torus(ring_radius: float, tube_radius: float) -> Part:
    """A ring about the z axis with a round cross-section."""
    return Part(
        sdf.Torus(ring_radius, tube_radius),
        round_mesh.torus(ring_radius, tube_radius),
        _torus_hulls(ring_radius, tube_radius),
        masses.of_torus(ring_radius, tube_radius),
        Outline.of_circles(np.array([ring_radius]), np.zeros(1), tube_radius),
    )


def revolution(profile: Corners, pieces: Sequence[np.ndarray] | None = None) -> Part:
    """Build the solid that a counter-clockwise polygon (r >= 0, z) sweeps about the z axis.

    `pieces` are convex polygons that cover it, for physics; without them the profile itself is convex.
    """
    corners = np.asarray(profile, float)
    rims = convex_hull(corners)
    return Part(
        sdf.Revolution(corners),
        meshes.revolution(corners),
        tuple(hull for piece in (pieces or [corners]) for hull in _revolution_hulls(piece)),
        masses.of_revolution(corners),
        Outline.of_circles(rims[:, 0], rims[:, 1]),
    )


def cylinder(radius: float, height: float) -> Part:
    """A cylinder along z around the origin."""
    half = 0.5 * height
    part = revolution([[0, -half], [radius, -half], [radius, half], [0, half]])
    return replace(part, primitive=("cylinder", (radius, height)))


def frustum(low_radius: float, high_radius: float, height: float) -> Part:
    """A cut cone along z from z = -height/2 to z = height/2; a cone, if one radius is 0."""
    half = 0.5 * height
    rims = [[radius, z] for radius, z in ((low_radius, -half), (high_radius, half)) if radius]
    return revolution([[0, -half], *rims, [0, half]])


def extrusion(polygon: Corners, pieces: Sequence[Sequence[int]], height: float) -> Part:
    """A prism along z, symmetric about z = 0, over a counter-clockwise polygon with its cut into convex pieces."""
    corners = np.asarray(polygon, float)
    mesh = meshes.extrusion(corners, pieces, height)
    hulls = tuple(mesh.vertices[np.concatenate([np.array(piece), np.array(piece) + len(corners)])] for piece in pieces)
    return Part(
        sdf.Extrusion(corners, height),
        mesh,
        hulls,
        masses.of_mesh(mesh.vertices, mesh.faces),
        Outline.of_points(mesh.vertices),
    )


def polyhedron(mesh: Mesh) -> Part:
    """The inside of a closed convex mesh; its planes are those of the faces, equal ones counted once."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    normals = meshes.unit(cross(b - a, c - a))
    planes = np.hstack([normals, np.einsum("ij,ij->i", normals, a)[:, None]])
    _, kept = np.unique(np.round(planes, 9), axis=0, return_index=True)
    planes = planes[np.sort(kept)]
    return Part(
        sdf.ConvexPolyhedron(planes[:, :3], planes[:, 3]),
        mesh,
        (mesh.vertices,),
        masses.of_mesh(mesh.vertices, mesh.faces),
        Outline.of_points(mesh.vertices),
    )


def _revolution_hulls(profile: Float[np.ndarray, "corner 2"]) -> list[Float[np.ndarray, "_ 3"]]:
    """Corners of what a convex polygon (r, z) sweeps: one hull if it reaches the axis, wedges of a ring otherwise."""
    count = meshes.segments_of_circle(float(profile[:, 0].max()), HULL_ERROR, least=14)
    radii, heights = profile[:, None, :1], np.broadcast_to(profile[:, None, 1:], (len(profile), count, 1))
    rings = np.concatenate([radii * meshes.circle(count), heights], axis=2)
    if profile[:, 0].min() > 0:
        pairs = np.stack([rings, np.roll(rings, -1, axis=1)], axis=2)
        return list(np.swapaxes(pairs, 0, 1).reshape(count, -1, 3))
    return [np.concatenate([ring if r else ring[:1] for ring, r in zip(rings, profile[:, 0], strict=True)])]


def _torus_hulls(ring_radius: float, tube_radius: float) -> tuple[Float[np.ndarray, "_ 3"], ...]:
    tube = meshes.circle(meshes.segments_of_circle(tube_radius, HULL_ERROR, least=6))
    return tuple(_revolution_hulls(np.array([ring_radius, 0.0]) + tube_radius * tube))
