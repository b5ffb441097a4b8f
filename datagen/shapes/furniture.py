"""Furniture from boxes, cylinders and cones, standing upright along z with its front towards -y.

All lengths are metres. `legs` is "square" for boxes, "round" for cylinders, whose `leg` is side or diameter.
"""

from typing import Any

import numpy as np

from datagen.shapes import part as parts
from datagen.shapes.lathe import turned
from datagen.shapes.part import Part, assemble
from datagen.shapes.sampling import Size, longest, rounded
from datagen.shapes.shape import Numbers, Shape


def build_chair(
    width: float,
    depth: float,
    seat_height: float,
    thickness: float,
    back_height: float,
    slats: int,
    leg: float,
    legs: str,
    arm_height: float,
) -> Shape:
    """A chair.

    Args:
        width: of the seat along x.
        depth: of the seat along y.
        seat_height: of the seat's top.
        thickness: of seat and back.
        back_height: of the back above the seat.
        slats: horizontal slats between the back's posts; 0 for a solid back.
        leg: side or diameter of a leg.
        legs: "square" or "round".
        arm_height: of the arm rests above the seat; 0 for none.
    """
    top = seat_height
    pieces = [_slab((-width / 2, width / 2), (-depth / 2, depth / 2), (top - thickness, top))]
    pieces += _four_legs(width, depth, top - thickness, leg, legs)
    back = (depth / 2 - thickness, depth / 2)
    if slats:
        for side in (-1, 1):
            edge = side * (width / 2 - leg)
            pieces.append(_slab(sorted((edge, side * width / 2)), back, (top, top + back_height)))
        pitch = back_height / slats
        inner = (leg - width / 2, width / 2 - leg)
        for i in range(slats):
            end = top + (i + 1) * pitch
            pieces.append(_slab(inner, back, (end - 0.55 * pitch, end)))
    else:
        pieces.append(_slab((-width / 2, width / 2), back, (top, top + back_height)))
    if arm_height:
        for side in (-1, 1):
            x = sorted((side * (width / 2 - leg), side * width / 2))
            front = (-depth / 2, leg - depth / 2)
            pieces.append(_slab(x, front, (top, top + arm_height - thickness / 2)))
            pieces.append(_slab(x, (front[0], back[0]), (top + arm_height - thickness / 2, top + arm_height)))
    return assemble(pieces, "C1")


def build_stool(radius: float, height: float, thickness: float, leg_radius: float, legs: int) -> Shape:
    """A round seat of `radius` on several round legs; a single one stands in the middle on a foot."""
    seat = parts.cylinder(radius, thickness).placed([0, 0, height - thickness / 2])
    free = height - thickness
    if legs == 1:
        foot = parts.cylinder(0.8 * radius, thickness).placed([0, 0, thickness / 2])
        column = parts.cylinder(leg_radius, free - thickness).placed([0, 0, (free + thickness) / 2])
        return assemble([seat, foot, column], "Cinf")
    leg = parts.cylinder(leg_radius, free)
    angles = 2 * np.pi * np.arange(legs) / legs
    reach = radius - 1.2 * leg_radius
    return assemble([seat, *(leg.placed([reach * np.cos(a), reach * np.sin(a), free / 2]) for a in angles)], f"C{legs}")


def build_table(width: float, depth: float, height: float, thickness: float, leg: float, legs: str) -> Shape:
    """A rectangular top of the given thickness on four legs."""
    top = _slab((-width / 2, width / 2), (-depth / 2, depth / 2), (height - thickness, height))
    symmetry = "C4" if width == depth else "C2"
    return assemble([top, *_four_legs(width, depth, height - thickness, leg, legs)], symmetry)


def build_desk(width: float, depth: float, height: float, thickness: float, drawers: float) -> Shape:
    """A top on two side panels, with a block of drawers of width `drawers` at the right."""
    free = height - thickness
    y = (-depth / 2, depth / 2)
    pieces = [
        _slab((-width / 2, width / 2), y, (free, height)),
        _slab((-width / 2, thickness - width / 2), y, (0, free)),
        _slab((width / 2 - drawers, width / 2), y, (0, free)),
        _slab((thickness - width / 2, width / 2 - drawers), (depth / 2 - thickness, depth / 2), (0.4 * free, free)),
    ]
    for i in range(3):
        middle = (i + 0.5) * free / 3
        front = (-depth / 2 - 0.5 * thickness, -depth / 2)
        x = (width / 2 - 0.65 * drawers, width / 2 - 0.35 * drawers)
        pieces.append(_slab(x, front, (middle - 0.3 * thickness, middle + 0.3 * thickness)))
    return assemble(pieces, "C1")


def build_cabinet(width: float, depth: float, height: float, foot: float, door: float, doors: int) -> Shape:
    """A box on four feet with doors of thickness `door` and a knob on each."""
    pieces = [_slab((-width / 2, width / 2), (-depth / 2, depth / 2), (foot, height))]
    pieces += _four_legs(width, depth, foot, foot, "square")
    gap = 0.06 * width
    pitch = (width - gap) / doors
    front = (-depth / 2 - door, -depth / 2)
    along = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    knob = parts.frustum(0.3 * gap, 0.5 * gap, gap)
    for i in range(doors):
        left = -width / 2 + gap + i * pitch
        pieces.append(_slab((left, left + pitch - gap), front, (foot + gap, height - gap)))
        x = left + pitch - 2 * gap if i % 2 == 0 else left + gap
        pieces.append(knob.placed([x, front[0] - gap / 2, (foot + height) / 2], along.T))
    return assemble(pieces, "C1")


def build_shelf(width: float, depth: float, height: float, thickness: float, boards: int, back: float) -> Shape:
    """Boards between two sides; `back` is the thickness of the rear wall, 0 for none."""
    y = (-depth / 2, depth / 2)
    inner = (thickness - width / 2, width / 2 - thickness)
    pieces = [_slab((-width / 2, inner[0]), y, (0, height)), _slab((inner[1], width / 2), y, (0, height))]
    front = (y[0], y[1] - back)
    pieces += [_slab(inner, front, (z, z + thickness)) for z in np.linspace(0, height - thickness, boards)]
    if back:
        pieces.append(_slab(inner, (front[1], y[1]), (0, height)))
    return assemble(pieces, "C1" if back else "D2")


def build_bench(width: float, depth: float, height: float, thickness: float, inset: float, back_height: float) -> Shape:
    """A board on two side panels `inset` from its ends, with a back rest above it unless `back_height` is 0."""
    y = (-depth / 2, depth / 2)
    pieces = [_slab((-width / 2, width / 2), y, (height - thickness, height))]
    for side in (-1, 1):
        outer = side * (width / 2 - inset)
        pieces.append(_slab(sorted((outer, outer - side * thickness)), y, (0, height - thickness)))
    if not back_height:
        return assemble(pieces, "C2")
    rear = (depth / 2 - thickness, depth / 2)
    pieces.append(_slab((-width / 2, width / 2), rear, (height + 0.4 * back_height, height + back_height)))
    for side in (-1, 1):
        x = sorted((side * (width / 2 - inset), side * (width / 2 - inset - thickness)))
        pieces.append(_slab(x, rear, (height, height + 0.4 * back_height)))
    return assemble(pieces, "C1")


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


def build_sofa(
    width: float, depth: float, seat_height: float, back_height: float, arm_height: float, thickness: float, seats: int
) -> Shape:
    """A base with a back, two arms and cushions.

    Args:
        width: outer, along x.
        depth: outer, along y.
        seat_height: of the base without cushions.
        back_height: of the back above the base.
        arm_height: of the arms above the base.
        thickness: of back and arms; cushions have half of it.
        seats: how many cushions.
    """
    x, y = (-width / 2, width / 2), (-depth / 2, depth / 2)
    inner = (x[0] + thickness, x[1] - thickness)
    rear = y[1] - thickness
    pieces = [_slab(x, y, (0, seat_height)), _slab(x, (rear, y[1]), (seat_height, seat_height + back_height))]
    arms = (seat_height, seat_height + arm_height)
    pieces += [_slab(side, (y[0], rear), arms) for side in ((x[0], inner[0]), (inner[1], x[1]))]
    pitch = (inner[1] - inner[0]) / seats
    for i in range(seats):
        left = inner[0] + (i + 0.03) * pitch
        pieces.append(_slab((left, left + 0.94 * pitch), (y[0], rear), (seat_height, seat_height + thickness / 2)))
    return assemble(pieces, "C1")


def build_bed(
    width: float, length: float, height: float, mattress: float, board_height: float, thickness: float
) -> Shape:
    """A frame on a plinth with a mattress, a board at its head (+y) and a lower one at its foot."""
    x = (-width / 2, width / 2)
    inner = (thickness - length / 2, length / 2 - thickness)
    pieces = [
        _slab(x, inner, (0.3 * height, height)),
        _slab((0.94 * x[0], 0.94 * x[1]), inner, (height, height + mattress)),
        _slab(x, (inner[1], length / 2), (0, board_height)),
        _slab(x, (-length / 2, inner[0]), (0, 0.6 * board_height)),
    ]
    return assemble(pieces, "C1")


def sample_chair(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """With a solid or a slatted back, with or without arms."""
    seat, back = rng.uniform(0.42, 0.5), rng.uniform(0.4, 0.6)
    lengths = {
        "width": rng.uniform(0.4, 0.55),
        "depth": rng.uniform(0.4, 0.52),
        "seat_height": seat,
        "thickness": rng.uniform(0.035, 0.07),
        "back_height": back,
        "leg": rng.uniform(0.035, 0.065),
        "arm_height": rng.uniform(0.18, 0.25) if rng.uniform() < 0.4 else 0.0,
    }
    choices = {"slats": int(rng.choice([0, 2, 3, 4])), "legs": str(rng.choice(["square", "round"]))}
    return rounded(lengths, longest(rng, size) / (seat + back)) | choices


def sample_stool(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """One, three or four legs."""
    height = rng.uniform(0.45, 0.8)
    lengths = {
        "radius": rng.uniform(0.16, 0.22),
        "height": height,
        "thickness": rng.uniform(0.04, 0.07),
        "leg_radius": rng.uniform(0.018, 0.03),
    }
    return rounded(lengths, longest(rng, size) / height) | {"legs": int(rng.choice([1, 3, 4]))}


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
    """From sideboards to wardrobes."""
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
        "back": rng.uniform(0.015, 0.03) if rng.uniform() < 0.6 else 0.0,
    }
    return rounded(lengths, longest(rng, size) / max(width, height)) | {"boards": int(rng.integers(3, 7))}


def sample_bench(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """With or without a back."""
    width = rng.uniform(1.1, 1.7)
    lengths = {
        "width": width,
        "depth": rng.uniform(0.35, 0.5),
        "height": rng.uniform(0.4, 0.5),
        "thickness": rng.uniform(0.05, 0.08),
        "inset": rng.uniform(0.06, 0.2),
        "back_height": rng.uniform(0.35, 0.5) if rng.uniform() < 0.5 else 0.0,
    }
    return rounded(lengths, longest(rng, size) / width)


def sample_lamp(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """From table lamps to floor lamps."""
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


def sample_sofa(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """One to three seats."""
    seats = int(rng.integers(1, 4))
    width = 0.45 + seats * rng.uniform(0.5, 0.6)
    depth, seat, back = rng.uniform(0.75, 0.9), rng.uniform(0.25, 0.35), rng.uniform(0.4, 0.5)
    lengths = {
        "width": width,
        "depth": depth,
        "seat_height": seat,
        "back_height": back,
        "arm_height": rng.uniform(0.2, 0.3),
        "thickness": rng.uniform(0.16, 0.22),
    }
    return rounded(lengths, longest(rng, size) / max(width, depth, seat + back)) | {"seats": seats}


def sample_bed(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Single or double."""
    lengths = {
        "width": rng.uniform(0.9, 1.7),
        "length": 2.05,
        "height": rng.uniform(0.28, 0.38),
        "mattress": rng.uniform(0.14, 0.22),
        "board_height": rng.uniform(0.7, 1.0),
        "thickness": rng.uniform(0.05, 0.08),
    }
    return rounded(lengths, longest(rng, size) / 2.05)


def _slab(x: Numbers, y: Numbers, z: Numbers) -> Part:
    """The box between the given bounds."""
    low, high = np.array([x, y, z], float).T
    return parts.box(high - low).placed(0.5 * (low + high))


def _four_legs(width: float, depth: float, height: float, leg: float, legs: str) -> list[Part]:
    """Legs under the corners of a rectangle, from the floor to `height`."""
    one = parts.box((leg, leg, height)) if legs == "square" else parts.cylinder(leg / 2, height)
    x, y = (width - leg) / 2, (depth - leg) / 2
    return [one.placed([i * x, j * y, height / 2]) for i in (-1, 1) for j in (-1, 1)]
