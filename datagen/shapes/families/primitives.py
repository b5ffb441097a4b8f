"""Analytic primitives: box, sphere, cylinder, frustum (cones are frustums with a tip), capsule, torus, ellipsoid."""

from typing import Any

import numpy as np

from datagen.shapes import part as parts
from datagen.shapes.part import assemble, slab
from datagen.shapes.sampling import Size, draw, longest, rounded
from datagen.shapes.shape import Shape


def build_box(size: list[float]) -> Shape:
    """A box with the given full side lengths along x, y, z; where only two are equal, the third lies along z."""
    x, y, z = size = odd_last(size)
    symmetry = "O" if x == y == z else "D4" if x == y else "D2"
    return assemble([parts.box(size)], symmetry, aligned=True)


def build_sphere(radius: float) -> Shape:
    """A ball."""
    return assemble([parts.sphere(radius)], "SO3", aligned=True)


def build_cylinder(radius: float, height: float) -> Shape:
    """A cylinder along z."""
    return assemble([parts.cylinder(radius, height)], "Dinf", aligned=True)


def build_frustum(low_radius: float, high_radius: float, height: float) -> Shape:
    """A cut cone along z, with a tip where a radius is 0."""
    if low_radius == high_radius:
        return build_cylinder(low_radius, height)
    return assemble([parts.frustum(low_radius, high_radius, height)], "Cinf")


def build_capsule(radius: float, length: float) -> Shape:
    """A cylinder of the given length along z between two half balls."""
    return assemble([parts.capsule(radius, length)], "Dinf", aligned=True)


def build_torus(ring_radius: float, tube_radius: float) -> Shape:
    """A ring about z with a round tube."""
    return assemble([parts.torus(ring_radius, tube_radius)], "Dinf", aligned=True)


def build_ellipsoid(half_axes: list[float]) -> Shape:
    """An ellipsoid with the given half axes along x, y, z; where only two are equal, the third lies along z."""
    x, y, z = half_axes = odd_last(half_axes)
    symmetry = "SO3" if x == y == z else "Dinf" if x == y else "D2"
    return assemble([parts.ellipsoid(half_axes)], symmetry, aligned=True)


def build_crate(width: float, depth: float, height: float, wall: float) -> Shape:
    """A box without a lid, with walls and a floor of one thickness."""
    x, y, z = (-width / 2, width / 2), (-depth / 2, depth / 2), (wall, height)
    pieces = [slab(x, y, (0, wall))]
    for side in (-1, 1):
        pieces.append(slab(sorted((side * width / 2, side * (width / 2 - wall))), y, z))
        pieces.append(slab((x[0] + wall, x[1] - wall), sorted((side * depth / 2, side * (depth / 2 - wall))), z))
    return assemble(pieces, "C4" if width == depth else "C2")


def odd_last(lengths: list[float]) -> list[float]:
    """Three lengths in their order or, where only two are equal, turned so that they come first.

    The fourfold axis of symmetry then is z, as the names of groups want it.
    """
    x, y, z = lengths
    return [y, z, x] if y == z else [z, x, y] if z == x else lengths


def sample_box(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a brick, a bar, a plate, or (one in five each) a box on a square and a cube."""
    kind = rng.uniform()
    x, y, z = rng.uniform(0.3, 1, 3)
    sides = [x, x, x] if kind < 0.2 else [x, x, z] if kind < 0.4 else [x, y, z]
    return rounded({"size": sides}, longest(rng, size) / max(sides))


def sample_crate(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw an open box, from trays to bins."""
    lengths = draw(rng, width=1.0, depth=(0.6, 1.0), height=(0.2, 0.6), wall=(0.025, 0.04))
    return rounded(lengths, longest(rng, size))


def sample_cube(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a cube."""
    return rounded({"size": [1.0, 1.0, 1.0]}, longest(rng, size))


def sample_sphere(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a ball of any radius."""
    return rounded({"radius": 0.5}, longest(rng, size))


def sample_cylinder(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a cylinder, from a coin to a rod."""
    aspect = np.exp(rng.uniform(np.log(0.35), np.log(3)))
    return rounded({"radius": 0.5, "height": aspect}, longest(rng, size) / max(1, aspect))


def sample_can(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a cylinder as high as it is wide."""
    return rounded({"radius": 0.5, "height": 1.0}, longest(rng, size))


def sample_cone(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a cone on its base, with a tip."""
    height = rng.uniform(0.7, 2)
    return rounded({"low_radius": 0.5, "high_radius": 0.0, "height": height}, longest(rng, size) / max(1, height))


def sample_frustum(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a cut cone that narrows towards +z."""
    height, high = rng.uniform(0.5, 2), rng.uniform(0.15, 0.4)
    return rounded({"low_radius": 0.5, "high_radius": high, "height": height}, longest(rng, size) / max(1, height))


def sample_capsule(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a capsule, from nearly round to a stick."""
    length = rng.uniform(0.4, 3)
    return rounded({"radius": 0.5, "length": length}, longest(rng, size) / (1 + length))


def sample_torus(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a ring with an open hole."""
    tube = rng.uniform(0.22, 0.5)
    return rounded({"ring_radius": 1.0, "tube_radius": tube}, longest(rng, size) / (2 + 2 * tube))


def sample_ellipsoid(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw an ellipsoid with three different half axes, or (one in three) a spheroid."""
    x, y, z = rng.uniform(0.45, 1, 3)
    axes = [x, x, z] if rng.uniform() < 1 / 3 else [x, y, z]
    return rounded({"half_axes": axes}, longest(rng, size) / (2 * max(axes)))
