"""Tables, desks, cabinets, shelves and lamps from simple parts, upright along z, their front towards -y.

All lengths are metres. `legs` is "square" for boxes or "round" for cylinders, and `leg` their side or diameter.
"""

from typing import Any

import numpy as np

from datagen.shapes import part as parts
from datagen.shapes.families.lathe import turned
from datagen.shapes.families.seating import four_legs
from datagen.shapes.part import assemble, slab
from datagen.shapes.sampling import Size, longest, rounded
from datagen.shapes.shape import Shape


def build_table(width: float, depth: float, height: float, thickness: float, leg: float, legs: str) -> Shape:
    """A rectangular top of the given thickness on four legs."""
    top = slab((-width / 2, width / 2), (-depth / 2, depth / 2), (height - thickness, height))
    symmetry = "C4" if width == depth else "C2"
    return assemble([top, *four_legs(width, depth, height - thickness, leg, legs)], symmetry)


def build_desk(width: float, depth: float, height: float, thickness: float, drawers: float) -> Shape:
    """A top on two side panels, with a block of drawers of width `drawers` at the right."""
    free = height - thickness
    y = (-depth / 2, depth / 2)
    pieces = [
        slab((-width / 2, width / 2), y, (free, height)),
        slab((-width / 2, thickness - width / 2), y, (0, free)),
        slab((width / 2 - drawers, width / 2), y, (0, free)),
        slab((thickness - width / 2, width / 2 - drawers), (depth / 2 - thickness, depth / 2), (0.4 * free, free)),
    ]
    for i in range(3):
        middle = (i + 0.5) * free / 3
        front = (-depth / 2 - 0.5 * thickness, -depth / 2)
        x = (width / 2 - 0.65 * drawers, width / 2 - 0.35 * drawers)
        pieces.append(slab(x, front, (middle - 0.3 * thickness, middle + 0.3 * thickness)))
    return assemble(pieces, "C1")


def build_cabinet(width: float, depth: float, height: float, foot: float, door: float, doors: int) -> Shape:
    """A box on four feet with doors of thickness `door` and a knob on each."""
    pieces = [slab((-width / 2, width / 2), (-depth / 2, depth / 2), (foot, height))]
    pieces += four_legs(width, depth, foot, foot, "square")
    gap = 0.06 * width
    pitch = (width - gap) / doors
    front = (-depth / 2 - door, -depth / 2)
    along = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    knob = parts.frustum(0.3 * gap, 0.5 * gap, gap)
    for i in range(doors):
        left = -width / 2 + gap + i * pitch
        pieces.append(slab((left, left + pitch - gap), front, (foot + gap, height - gap)))
        x = left + pitch - 2 * gap if i % 2 == 0 else left + gap
        pieces.append(knob.placed([x, front[0] - gap / 2, (foot + height) / 2], along.T))
    return assemble(pieces, "C1")


def build_shelf(
    width: float, depth: float, height: float, thickness: float, foot: float, boards: int, back: float
) -> Shape:
    """Boards between two sides.

    Args:
        width: outer, along x.
        depth: along y.
        height: of the sides and of the highest board's top.
        thickness: of sides and boards.
        foot: height below the lowest board.
        boards: how many.
        back: thickness of the rear wall; 0 for none.
    """
    y = (-depth / 2, depth / 2)
    inner = (thickness - width / 2, width / 2 - thickness)
    pieces = [slab((-width / 2, inner[0]), y, (0, height)), slab((inner[1], width / 2), y, (0, height))]
    front = (y[0], y[1] - back)
    pieces += [slab(inner, front, (z, z + thickness)) for z in np.linspace(foot, height - thickness, boards)]
    if back:
        pieces.append(slab(inner, (front[1], y[1]), (foot, height)))
    return assemble(pieces, "C1" if back else "C2")


def build_lamp(
    foot_radius: float, foot_height: float, pole_radius: float, height: float, shade: list[float], wall: float
) -> Shape:
    """A lamp with a hollow shade that is closed at its top, where the pole ends.

    Args:
        foot_radius: of the foot.
        foot_height: of the foot.
        pole_radius: of the pole.
        height: of the whole lamp.
        shade: its radius below, its radius above, its height.
        wall: thickness of the shade.
    """
    low, high, tall = shade
    top = height - wall
    pole = parts.cylinder(pole_radius, top - foot_height).placed([0, 0, (top + foot_height) / 2])
    foot = parts.cylinder(foot_radius, foot_height).placed([0, 0, foot_height / 2])
    upside_down = turned([[high, 0], [low, tall]], wall, wall).placed([0, 0, height], np.diag([1.0, -1.0, -1.0]))
    return assemble([foot, pole, upside_down], "Cinf")


def sample_table(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Rectangular, square in one of four cases."""
    width = rng.uniform(0.9, 1.6)
    depth = width if rng.uniform() < 0.25 else rng.uniform(0.6, 0.85)
    lengths = {
        "width": width,
        "depth": depth,
        "height": rng.uniform(0.5, 0.78),
        "thickness": rng.uniform(0.04, 0.08),
        "leg": rng.uniform(0.05, 0.1),
    }
    return rounded(lengths, longest(rng, size) / width) | {"legs": str(rng.choice(["square", "round"]))}


def sample_round_table(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """A round top on one, three or four legs: a stool of other proportions."""
    radius = rng.uniform(0.45, 0.6)
    lengths = {
        "radius": radius,
        "height": rng.uniform(0.6, 0.8),
        "thickness": rng.uniform(0.04, 0.07),
        "leg_radius": rng.uniform(0.03, 0.06),
    }
    return rounded(lengths, longest(rng, size) / (2 * radius)) | {"legs": int(rng.choice([1, 3, 4]))}


def sample_desk(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """A writing desk."""
    width = rng.uniform(1.1, 1.6)
    lengths = {
        "width": width,
        "depth": rng.uniform(0.55, 0.75),
        "height": rng.uniform(0.7, 0.78),
        "thickness": rng.uniform(0.04, 0.06),
        "drawers": rng.uniform(0.35, 0.45),
    }
    return rounded(lengths, longest(rng, size) / width)


def sample_cabinet(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a cabinet, from sideboards to wardrobes."""
    width, height = rng.uniform(0.6, 1.3), rng.uniform(0.7, 1.6)
    lengths = {
        "width": width,
        "depth": rng.uniform(0.35, 0.5),
        "height": height,
        "foot": rng.uniform(0.05, 0.1),
        "door": rng.uniform(0.02, 0.03),
    }
    return rounded(lengths, longest(rng, size) / max(width, height)) | {"doors": int(rng.integers(1, 4))}


def sample_shelf(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Three to six boards, with or without a rear wall."""
    width, height = rng.uniform(0.6, 1.1), rng.uniform(0.8, 1.6)
    lengths = {
        "width": width,
        "depth": rng.uniform(0.25, 0.4),
        "height": height,
        "thickness": rng.uniform(0.03, 0.05),
        "foot": rng.uniform(0.06, 0.12),
        "back": rng.uniform(0.015, 0.03) if rng.uniform() < 0.6 else 0.0,
    }
    return rounded(lengths, longest(rng, size) / max(width, height)) | {"boards": int(rng.integers(3, 7))}


def sample_lamp(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a lamp, from table lamps to floor lamps."""
    low = rng.uniform(0.14, 0.25)
    lengths = {
        "foot_radius": rng.uniform(0.12, 0.2),
        "foot_height": rng.uniform(0.03, 0.06),
        "pole_radius": rng.uniform(0.018, 0.03),
        "height": 1.0,
        "shade": [low, low * rng.uniform(0.5, 0.95), rng.uniform(0.22, 0.35)],
        "wall": rng.uniform(0.018, 0.025),
    }
    return rounded(lengths, longest(rng, size))
