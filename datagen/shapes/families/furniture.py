"""Furniture from simple parts, upright along z, its front towards -y.

All lengths are metres. `legs` is "square" for boxes or "round" for cylinders, and `leg` their side or diameter.
"""

from typing import Any

import numpy as np

from datagen.shapes import part as parts
from datagen.shapes.families.lathe import turned
from datagen.shapes.part import Part, assemble, slab
from datagen.shapes.sampling import Size, draw, longest, rounded
from datagen.shapes.shape import Shape


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
    """A chair whose seat and back have one thickness.

    Heights of back and arm rests are above the seat's top; without arm rests theirs is 0. The back has horizontal
    slats between its posts, or is solid if `slats` is 0.
    """
    top = seat_height
    pieces = [slab((-width / 2, width / 2), (-depth / 2, depth / 2), (top - thickness, top))]
    pieces += four_legs(width, depth, top - thickness, leg, legs)
    back = (depth / 2 - thickness, depth / 2)
    if slats:
        for side in (-1, 1):
            edge = side * (width / 2 - leg)
            pieces.append(slab(sorted((edge, side * width / 2)), back, (top, top + back_height)))
        pitch = back_height / slats
        inner = (leg - width / 2, width / 2 - leg)
        for i in range(slats):
            end = top + (i + 1) * pitch
            pieces.append(slab(inner, back, (end - 0.55 * pitch, end)))
    else:
        pieces.append(slab((-width / 2, width / 2), back, (top, top + back_height)))
    if arm_height:
        for side in (-1, 1):
            x = sorted((side * (width / 2 - leg), side * width / 2))
            front = (-depth / 2, leg - depth / 2)
            pieces.append(slab(x, front, (top, top + arm_height - thickness / 2)))
            pieces.append(slab(x, (front[0], back[0]), (top + arm_height - thickness / 2, top + arm_height)))
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


def build_bench(width: float, depth: float, height: float, thickness: float, inset: float, back_height: float) -> Shape:
    """A board on two side panels `inset` from its ends, with a back rest above it unless `back_height` is 0."""
    y = (-depth / 2, depth / 2)
    pieces = [slab((-width / 2, width / 2), y, (height - thickness, height))]
    for side in (-1, 1):
        outer = side * (width / 2 - inset)
        pieces.append(slab(sorted((outer, outer - side * thickness)), y, (0, height - thickness)))
    if not back_height:
        return assemble(pieces, "C2")
    rear = (depth / 2 - thickness, depth / 2)
    pieces.append(slab((-width / 2, width / 2), rear, (height + 0.4 * back_height, height + back_height)))
    for side in (-1, 1):
        x = sorted((side * (width / 2 - inset), side * (width / 2 - inset - thickness)))
        pieces.append(slab(x, rear, (height, height + 0.4 * back_height)))
    return assemble(pieces, "C1")


def build_sofa(
    width: float, depth: float, seat_height: float, back_height: float, arm_height: float, thickness: float, seats: int
) -> Shape:
    """A base of `seat_height` with a back and two arms above it, and `seats` cushions of half their thickness."""
    x, y = (-width / 2, width / 2), (-depth / 2, depth / 2)
    inner = (x[0] + thickness, x[1] - thickness)
    rear = y[1] - thickness
    pieces = [slab(x, y, (0, seat_height)), slab(x, (rear, y[1]), (seat_height, seat_height + back_height))]
    arms = (seat_height, seat_height + arm_height)
    pieces += [slab(side, (y[0], rear), arms) for side in ((x[0], inner[0]), (inner[1], x[1]))]
    pitch = (inner[1] - inner[0]) / seats
    for i in range(seats):
        left = inner[0] + (i + 0.03) * pitch
        pieces.append(slab((left, left + 0.94 * pitch), (y[0], rear), (seat_height, seat_height + thickness / 2)))
    return assemble(pieces, "C1")


def build_bed(
    width: float, length: float, height: float, mattress: float, board_height: float, thickness: float
) -> Shape:
    """A frame on a plinth with a mattress, a board at its head (+y) and a lower one at its foot."""
    x = (-width / 2, width / 2)
    inner = (thickness - length / 2, length / 2 - thickness)
    plinth = slab(x, inner, (0.3 * height, height))
    top = slab((0.94 * x[0], 0.94 * x[1]), inner, (height, height + mattress))
    head, foot = slab(x, (inner[1], length / 2), (0, board_height)), (-length / 2, inner[0])
    return assemble([plinth, top, head, slab(x, foot, (0, 0.6 * board_height))], "C1")


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
    """Boards between two sides, from `foot` above the ground, with a rear wall of thickness `back` unless that is 0."""
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
    """A lamp whose hollow shade (radius below, radius above, height) is closed at its top, where the pole ends."""
    low, high, tall = shade
    top = height - wall
    pole = parts.cylinder(pole_radius, top - foot_height).placed([0, 0, (top + foot_height) / 2])
    foot = parts.cylinder(foot_radius, foot_height).placed([0, 0, foot_height / 2])
    upside_down = turned([[high, 0], [low, tall]], wall, wall).placed([0, 0, height], np.diag([1.0, -1.0, -1.0]))
    return assemble([foot, pole, upside_down], "Cinf")


def sample_chair(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a chair with a solid or slatted back, with or without arms."""
    seat, back = rng.uniform(0.42, 0.5), rng.uniform(0.4, 0.6)
    lengths = draw(rng, width=(0.4, 0.55), depth=(0.4, 0.52), seat_height=seat, thickness=(0.035, 0.07))
    lengths |= draw(rng, back_height=back, leg=(0.035, 0.065))
    lengths["arm_height"] = rng.uniform(0.18, 0.25) if rng.uniform() < 0.4 else 0.0
    choices = {"slats": int(rng.choice([0, 2, 3, 4])), "legs": str(rng.choice(["square", "round"]))}
    return rounded(lengths, longest(rng, size) / (seat + back)) | choices


def sample_stool(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a stool with one, three or four legs."""
    height = rng.uniform(0.45, 0.8)
    lengths = draw(rng, radius=(0.16, 0.22), height=height, thickness=(0.04, 0.07), leg_radius=(0.018, 0.03))
    return rounded(lengths, longest(rng, size) / height) | {"legs": int(rng.choice([1, 3, 4]))}


def sample_bench(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a bench with or without a back."""
    width = rng.uniform(1.1, 1.7)
    lengths = draw(rng, width=width, depth=(0.35, 0.5), height=(0.4, 0.5), thickness=(0.05, 0.08), inset=(0.06, 0.2))
    lengths["back_height"] = rng.uniform(0.35, 0.5) if rng.uniform() < 0.5 else 0.0
    return rounded(lengths, longest(rng, size) / width)


def sample_sofa(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a sofa with one to three seats."""
    seats = int(rng.integers(1, 4))
    width = 0.45 + seats * rng.uniform(0.5, 0.6)
    depth, seat, back = rng.uniform(0.75, 0.9), rng.uniform(0.25, 0.35), rng.uniform(0.4, 0.5)
    lengths = draw(rng, width=width, depth=depth, seat_height=seat, back_height=back)
    lengths |= draw(rng, arm_height=(0.2, 0.3), thickness=(0.16, 0.22))
    return rounded(lengths, longest(rng, size) / max(width, depth, seat + back)) | {"seats": seats}


def sample_bed(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a single or double bed."""
    lengths = draw(rng, width=(0.9, 1.7), length=2.05, height=(0.28, 0.38), mattress=(0.14, 0.22))
    lengths |= draw(rng, board_height=(0.7, 1.0), thickness=(0.05, 0.08))
    return rounded(lengths, longest(rng, size) / 2.05)


def sample_table(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a rectangular table, a square one in one of four cases."""
    width = rng.uniform(0.9, 1.6)
    depth = width if rng.uniform() < 0.25 else rng.uniform(0.6, 0.85)
    lengths = draw(rng, width=width, depth=depth, height=(0.5, 0.78), thickness=(0.04, 0.08), leg=(0.05, 0.1))
    return rounded(lengths, longest(rng, size) / width) | {"legs": str(rng.choice(["square", "round"]))}


def sample_round_table(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a round top on one, three or four legs: a stool of other proportions."""
    radius = rng.uniform(0.45, 0.6)
    lengths = draw(rng, radius=radius, height=(0.6, 0.8), thickness=(0.04, 0.07), leg_radius=(0.03, 0.06))
    return rounded(lengths, longest(rng, size) / (2 * radius)) | {"legs": int(rng.choice([1, 3, 4]))}


def sample_desk(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a writing desk."""
    width = rng.uniform(1.1, 1.6)
    lengths = draw(
        rng, width=width, depth=(0.55, 0.75), height=(0.7, 0.78), thickness=(0.04, 0.06), drawers=(0.35, 0.45)
    )
    return rounded(lengths, longest(rng, size) / width)


def sample_cabinet(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a cabinet, from sideboards to wardrobes."""
    width, height = rng.uniform(0.6, 1.3), rng.uniform(0.7, 1.6)
    lengths = draw(rng, width=width, depth=(0.35, 0.5), height=height, foot=(0.05, 0.1), door=(0.02, 0.03))
    return rounded(lengths, longest(rng, size) / max(width, height)) | {"doors": int(rng.integers(1, 4))}


def sample_shelf(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a shelf of three to six boards, with or without a rear wall."""
    width, height = rng.uniform(0.6, 1.1), rng.uniform(0.8, 1.6)
    lengths = draw(rng, width=width, depth=(0.25, 0.4), height=height, thickness=(0.03, 0.05), foot=(0.06, 0.12))
    lengths["back"] = rng.uniform(0.015, 0.03) if rng.uniform() < 0.6 else 0.0
    return rounded(lengths, longest(rng, size) / max(width, height)) | {"boards": int(rng.integers(3, 7))}


def sample_lamp(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a lamp, from table lamps to floor lamps."""
    low = rng.uniform(0.14, 0.25)
    lengths: dict[str, Any] = draw(
        rng, foot_radius=(0.12, 0.2), foot_height=(0.03, 0.06), pole_radius=(0.018, 0.03), height=1.0
    )
    lengths["shade"] = [low, low * rng.uniform(0.5, 0.95), rng.uniform(0.22, 0.35)]
    lengths["wall"] = rng.uniform(0.018, 0.025)
    return rounded(lengths, longest(rng, size))


def four_legs(width: float, depth: float, height: float, leg: float, legs: str) -> list[Part]:
    """Legs under the corners of a rectangle, from the floor to `height`."""
    one = parts.box((leg, leg, height)) if legs == "square" else parts.cylinder(leg / 2, height)
    x, y = (width - leg) / 2, (depth - leg) / 2
    return [one.placed([i * x, j * y, height / 2]) for i in (-1, 1) for j in (-1, 1)]
