"""Superquadrics: rounded boxes, pillows and pinched solids (Barr 1981), as convex polyhedra with smooth normals."""

from typing import Any

import numpy as np
from jaxtyping import Float

from datagen.shapes import part as parts
from datagen.shapes.geometry import mesh as meshes
from datagen.shapes.part import assemble
from datagen.shapes.sampling import Size, longest, rounded
from datagen.shapes.shape import Shape

STEPS = 24
"""Number of corners around z; a multiple of four, so that the polyhedron has the superquadric's symmetry."""

LEVELS = 13
"""Number of levels from pole to pole."""


def build(half_axes: list[float], roundness: float, squareness: float) -> Shape:
    """The polyhedron with its corners on |(x/a)^(2/e2) + (y/b)^(2/e2)|^(e2/e1) + |z/c|^(2/e1) = 1.

    All quadrilaterals of its mesh are planar, for every level is a scaled copy of the same ring. Half axes a, b, c are
    in metres. Roundness e1 (along z) and squareness e2 (around z) are near 0 for sharp edges, 1 if round, 2 if pointed.
    """
    a, b, c = half_axes
    turn = 2 * np.pi * np.arange(STEPS) / STEPS
    tilt = np.linspace(-0.5 * np.pi, 0.5 * np.pi, LEVELS)
    ring = np.stack([a * _power(np.cos(turn), squareness), b * _power(np.sin(turn), squareness)], axis=-1)
    profile = np.stack([_power(np.cos(tilt), roundness), c * _power(np.sin(tilt), roundness)], axis=-1)
    around = np.stack([_power(np.cos(turn), 2 - squareness) / a, _power(np.sin(turn), 2 - squareness) / b], axis=-1)
    upward = np.repeat(_power(np.sin(tilt), 2 - roundness)[:, None, None] / c, STEPS, axis=1)
    normals = np.concatenate([_power(np.cos(tilt), 2 - roundness)[:, None, None] * around, upward], axis=-1)
    mesh = meshes.lofted(ring, profile, meshes.unit(normals))
    symmetry = "D2" if a != b else f"D{STEPS}" if squareness == 1 else "D4"
    return assemble([parts.polyhedron(mesh)], symmetry)


def sample(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a rounded box (half of the cases) or anything from pillows to diamonds; one in four has equal a and b."""
    half_axes = rng.uniform(0.4, 1, 3)
    if rng.uniform() < 0.25:
        half_axes[1] = half_axes[0]
    low, high = (0.25, 0.6) if rng.uniform() < 0.5 else (0.3, 1.7)
    roundness, squareness = rng.uniform(low, high, 2)
    scaled = rounded({"half_axes": half_axes}, longest(rng, size) / (2 * half_axes.max()))
    return scaled | rounded({"roundness": roundness, "squareness": squareness})


def _power(base: Float[np.ndarray, "*any"], exponent: float) -> Float[np.ndarray, "*any"]:
    """Signed power; values that are zero but for rounding become zero, so that poles and mirror planes are exact."""
    clean = np.where(np.abs(base) < 1e-12, 0.0, base)
    return np.sign(clean) * np.abs(clean) ** exponent
