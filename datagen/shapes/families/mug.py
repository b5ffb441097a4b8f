"""Mugs: a straight hollow cylinder with a handle."""

from typing import Any

import numpy as np
from jaxtyping import Float

from datagen.errors import UsageError
from datagen.shapes import part as parts
from datagen.shapes.families.lathe import turned
from datagen.shapes.geometry import mass as masses
from datagen.shapes.geometry.mass import Mass
from datagen.shapes.part import Part, assemble
from datagen.shapes.sampling import Size, draw, longest, rounded
from datagen.shapes.shape import Shape

ARC_STEPS = 10
"""Straight pieces of the handle's bend."""

STANDING = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
"""Turns a prism's xy plane into the xz plane."""


def build(
    radius: float,
    height: float,
    wall: float,
    floor: float,
    handle_height: float,
    handle_reach: float,
    handle_thickness: float,
    handle_width: float,
) -> Shape:
    """A mug that stands along z with its handle at +x, the handle half way up; all lengths in metres.

    `radius` is that of the outside; the handle's band is `handle_height` along z, `handle_width` along y, and stands
    out from the wall by `handle_reach`.

    Raises:
        UsageError: the handle is too wide to end inside the wall.
    """
    chord = np.sqrt(radius**2 - 0.25 * handle_width**2)
    if not radius - wall < chord:
        raise UsageError(f"A mug's wall of {wall} m is too thin for a handle {handle_width} m wide; make it thicker.")
    # Ending inside the wall, not on it, leaves no slit beside the triangles that stand for the wall.
    end = 0.5 * (chord + radius - wall)
    body = turned([[radius, 0], [radius, height]], wall, floor)
    band = _handle(end, radius + handle_reach, handle_height, handle_thickness, handle_width)
    overlap = _overlap(radius, end, handle_thickness, handle_width)
    rise = 0.5 * (handle_height - handle_thickness)
    common = [overlap.placed(np.eye(3), np.array([0, 0, 0.5 * height + offset])) for offset in (rise, -rise)]
    return assemble([body, band.placed([0, 0, 0.5 * height], STANDING)], "C1", overlap=common)


def sample(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a mug, from espresso cups to tankards."""
    height = rng.uniform(1.6, 2.6)
    parameters = draw(rng, radius=1.0, height=height, wall=(0.1, 0.15), floor=(0.12, 0.2))
    parameters["handle_height"] = height * rng.uniform(0.5, 0.75)
    parameters |= draw(rng, handle_reach=(0.5, 0.75), handle_thickness=(0.13, 0.2), handle_width=(0.3, 0.5))
    return rounded(parameters, longest(rng, size) / max(height, 2 + parameters["handle_reach"]))


def _handle(end: float, reach: float, height: float, thickness: float, width: float) -> Part:
    """A bent band in the xy plane from x = end to x = reach, symmetric about y = 0, `width` along z."""
    bend = min(0.5 * height, 0.7 * (reach - end))
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ARC_STEPS + 1)
    outer = _bend(reach - bend, bend, 0.5 * height, angles, end)
    inner = _bend(reach - bend, bend - thickness, 0.5 * height - thickness, angles, end)
    count = len(outer)
    pieces = [[i, i + 1, 2 * count - 2 - i, 2 * count - 1 - i] for i in range(count - 1)]
    return parts.extrusion(np.concatenate([outer, inner[::-1]]), pieces, width)


def _bend(
    middle: float, a: float, b: float, angles: Float[np.ndarray, "step"], end: float
) -> Float[np.ndarray, "corner 2"]:
    arc = np.stack([middle + a * np.cos(angles), b * np.sin(angles)], axis=1)
    return np.vstack([[end, -b], arc, [end, b]])


def _overlap(radius: float, end: float, thickness: float, width: float) -> Mass:
    """Mass of the intersection of a handle's end and the wall: a slab and a circular segment in front of it."""
    chord = np.sqrt(radius**2 - 0.25 * width**2)
    slab = masses.of_box((chord - end, width, thickness)).placed(np.eye(3), np.array([0.5 * (chord + end), 0, 0]))
    return masses.total([slab, masses.of_circular_segment(radius, width, thickness)])
