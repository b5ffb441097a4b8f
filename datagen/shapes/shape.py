"""Built shapes: a surface to render, its colours, solids to verify it, convex parts to simulate, and exact inertia.

All are in the object frame: metres, origin at the centre of mass of the homogeneous solid, z the main axis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8


@dataclass(frozen=True, eq=False)
class Skin:
    """Colour of every point of a mesh: the texture's, times the colour between the corners of the face."""

    uv: Float32[np.ndarray, "face 3 2"]
    """Texture coordinates of each face's corners; (0, 0) is the upper left corner; textures repeat."""
    colors: Float32[np.ndarray, "face 3 3"]
    """Linear RGB of each face's corners."""
    texture: Int[np.ndarray, "face"]
    """Texture of each face."""
    density: Float32[np.ndarray, "face"]
    """Texels per metre of each face at level 0 of its texture."""
    pyramids: tuple[tuple[UInt8[np.ndarray, "_ _ 3"], ...], ...]
    """Levels of each texture, sRGB; every level has half the size of the one before."""
    mean: tuple[float, float, float]
    """Mean colour of the surface, sRGB in 0..1."""


MESH_TOLERANCE = 8e-5
"""Largest distance of a rendered mesh from the exact surface, metres."""


Numbers = Sequence[float | int] | np.ndarray
"""A few numbers, such as side lengths."""

Corners = Sequence[Sequence[float | int]] | np.ndarray
"""Points of a plane, one per row."""

Primitive = tuple[Literal["box", "sphere", "cylinder", "capsule"], tuple[float, ...]]
"""A box (full side lengths), a sphere (radius), a cylinder (radius, height along z) or a capsule (radius, length of its
cylindrical part along z), each around the origin."""


@runtime_checkable
class Solid(Protocol):
    """A piece of a shape, given by its exact surface and not by triangles; a shape is the union of its solids."""

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Metres to the surface, negative inside.

        Zero exactly on the surface, exact to first order near it (away from edges), and never longer than the true
        distance, so that one may step along a ray by it.
        """
        ...


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """A box in the object frame."""

    center: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    """Columns are the box's axes."""
    size: Float[np.ndarray, "3"]
    """Full side lengths along these axes."""

    @property
    def corners(self) -> Float[np.ndarray, "8 3"]:
        """Corners in the object frame, the last axis varying fastest."""
        signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
        return self.center + (signs * self.size) @ self.rotation.T


@dataclass(frozen=True, eq=False)
class Shape:
    """One object's geometry."""

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]
    """Counter-clockwise seen from outside; the surface is closed (a union may have faces inside another part)."""
    normals: Float[np.ndarray, "face 3 3"]
    """Unit normals at each face's corners: shared across smooth surfaces, different on the two sides of an edge."""
    solids: tuple[Solid, ...]
    convex_parts: tuple[Float[np.ndarray, "_ 3"], ...]
    """Corner points of the convex hulls that physics uses; at most 1 mm from the true surface, except for meshes."""
    volume: float
    """Volume, cubic metres."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about the centre of mass of the homogeneous solid of density 1, m^5."""
    symmetry: str
    """Exact group of rotations that leave the shape unchanged, see `datagen.shapes.symmetry`."""
    minimum_box: OrientedBox
    """The box of least volume that holds the shape."""
    size: Float[np.ndarray, "3"]
    """Extents of the true surface along the object frame's axes, metres."""
    primitive: Primitive | None = None
    """Primitive that equals the whole shape exactly; None if there is none."""
    skin: Skin | None = None
    """Colours of a mesh with textures or vertex colours."""
    backs: int = 0
    """Number of faces at the end that are the back sides of others, drawn because the surface is open."""
    resting: tuple[tuple[float, float, float], ...] = ()
    """Directions of the object frame that may point down when a mesh rests; empty for all other families."""

    @property
    def radius(self) -> float:
        """Radius of the smallest origin-centred ball that holds the shape, metres."""
        return float(np.sqrt(np.max(np.sum(self.vertices**2, axis=1))))

    def signed_distance(self, points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
        """Signed distance to the union of the solids, see `Solid`; also 0 inside, where two solids touch."""
        return np.min([solid.signed_distance(points) for solid in self.solids], axis=0)


@runtime_checkable
class MeshSource(Protocol):
    """Geometry of the shapes that are stored in files; see `datagen.meshes.library.Library`."""

    def shape(self, parameters: Mapping[str, Any]) -> Shape:
        """The shape that a scene's description names."""
        ...
