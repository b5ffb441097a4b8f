"""Volume, centre of mass and inertia of homogeneous solids of density 1, exact up to rounding."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from datagen.geometry import cross
from datagen.shapes.shape import Numbers

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, eq=False)
class Mass:
    """Mass properties of a solid of density 1."""

    volume: float
    """Volume, cubic metres."""
    center: Float[np.ndarray, "3"]
    """Centre of mass, metres."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about the centre of mass at density 1, m^5."""

    def placed(self, rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> "Mass":
        """Mass of the solid after the motion `outer = rotation @ local + translation`."""
        return Mass(self.volume, rotation @ self.center + translation, rotation @ self.inertia @ rotation.T)

    def negative(self) -> "Mass":
        """Mass of the solid when it is subtracted, such as the intersection of two overlapping parts."""
        return Mass(-self.volume, self.center, -self.inertia)


def total(masses: Sequence[Mass]) -> Mass:
    """Sum of masses (parallel axis theorem)."""
    volume = sum(mass.volume for mass in masses)
    center = np.sum([mass.volume * mass.center for mass in masses], axis=0) / volume
    inertia = np.sum([mass.inertia + mass.volume * _steiner(mass.center - center) for mass in masses], axis=0)
    return Mass(volume, center, inertia)


def of_box(size: Numbers) -> Mass:
    """Mass of a box around the origin with the given full side lengths."""
    volume = float(np.prod(size))
    squares = np.square(size)
    return Mass(volume, np.zeros(3), np.diag(volume / 12 * (squares.sum() - squares)))


def of_ellipsoid(half_axes: Numbers) -> Mass:
    """Mass of an ellipsoid around the origin."""
    volume = 4 / 3 * np.pi * float(np.prod(half_axes))
    squares = np.square(half_axes)
    return Mass(volume, np.zeros(3), np.diag(volume / 5 * (squares.sum() - squares)))


def of_torus(ring_radius: float, tube_radius: float) -> Mass:
    """Mass of a torus around the z axis."""
    volume = 2 * np.pi**2 * ring_radius * tube_radius**2
    axial = volume * (ring_radius**2 + 0.75 * tube_radius**2)
    across = volume * (0.5 * ring_radius**2 + 0.625 * tube_radius**2)
    return Mass(volume, np.zeros(3), np.diag([across, across, axial]))


def of_revolution(profile: Float[np.ndarray, "corner 2"]) -> Mass:
    """Mass of the solid that a counter-clockwise polygon (r, z) sweeps about the z axis.

    Each edge stands for the frustum between it and the axis, counted negative where the edge runs down. Four Gauss
    nodes are exact for the polynomials of degree four that occur.
    """
    start, end = profile, np.roll(profile, -1, axis=0)
    nodes = start[:, None] + (0.5 + 0.5 * _NODES)[:, None] * (end - start)[:, None]
    weights = 0.5 * (end - start)[:, 1:] * _WEIGHTS
    return _from_slices(nodes[..., 0] ** 2, nodes[..., 1], weights)


def of_ball_slice(radius: float, low: float, high: float) -> Mass:
    """Mass of the part of a ball around the origin between the planes z = low and z = high."""
    z = 0.5 * (low + high) + 0.5 * (high - low) * _NODES
    return _from_slices(radius**2 - z**2, z, 0.5 * (high - low) * _WEIGHTS)


def of_mesh(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Mass:
    """Mass of the inside of a closed triangle mesh, a signed sum of tetrahedra with the origin."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    volumes = np.einsum("ij,ij->i", a, cross(b, c)) / 6
    volume = float(volumes.sum())
    corner_sum = a + b + c
    center = volumes @ corner_sum / (4 * volume)
    second = sum((x * volumes[:, None]).T @ x for x in (a, b, c, corner_sum)) / 20
    second = second - volume * np.outer(center, center)
    return Mass(volume, center, np.trace(second) * np.eye(3) - second)


def of_circular_segment(radius: float, chord: float, height: float) -> Mass:
    """Mass of a prism, symmetric about z = 0, over the segment at x > 0 that a chord cuts off a disc around z."""
    half_angle = np.arcsin(0.5 * chord / radius)
    s, c = np.sin(half_angle), np.cos(half_angle)
    area = radius**2 * (half_angle - s * c)
    center = 2 / 3 * (radius * s) ** 3 / area
    xx = radius**4 / 4 * (half_angle - s * c + 2 * s**3 * c) - area * center**2
    yy = radius**4 / 4 * (half_angle - s * c - 2 / 3 * s**3 * c)
    zz = area * height**2 / 12
    inertia = height * np.diag([yy + zz, xx + zz, xx + yy])
    return Mass(area * height, np.array([center, 0, 0]), inertia)


def _from_slices(
    radius_squared: Float[np.ndarray, "*slice"], z: Float[np.ndarray, "*slice"], thickness: Float[np.ndarray, "*slice"]
) -> Mass:
    areas = np.pi * radius_squared * thickness
    volume = float(areas.sum())
    center = float((areas * z).sum()) / volume
    axial = 0.5 * float((areas * radius_squared).sum())
    across = 0.5 * axial + float((areas * (z - center) ** 2).sum())
    return Mass(volume, np.array([0.0, 0.0, center]), np.diag([across, across, axial]))


def _steiner(offset: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    return (offset @ offset) * np.eye(3) - np.outer(offset, offset)
