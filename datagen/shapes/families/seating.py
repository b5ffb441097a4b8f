"""Chairs, stools, benches, sofas and beds from simple parts, upright along z, their front towards -y.

All lengths are metres. `legs` is "square" for boxes or "round" for cylinders, and `leg` their side or diameter.
"""

from typing import Any

import numpy as np

from datagen.shapes import part as parts
from datagen.shapes.part import Part, assemble, slab
from datagen.shapes.sampling import Size, longest, rounded
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
    pieces = [
        slab(x, inner, (0.3 * height, height)),
        slab((0.94 * x[0], 0.94 * x[1]), inner, (height, height + mattress)),
        slab(x, (inner[1], length / 2), (0, board_height)),
        slab(x, (-length / 2, inner[0]), (0, 0.6 * board_height)),
    ]
    return assemble(pieces, "C1")


def sample_chair(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a chair with a solid or slatted back, with or without arms."""
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


def sample_bench(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a bench with or without a back."""
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


def four_legs(width: float, depth: float, height: float, leg: float, legs: str) -> list[Part]:
    """Legs under the corners of a rectangle, from the floor to `height`."""
    one = parts.box((leg, leg, height)) if legs == "square" else parts.cylinder(leg / 2, height)
    x, y = (width - leg) / 2, (depth - leg) / 2
    return [one.placed([i * x, j * y, height / 2]) for i in (-1, 1) for j in (-1, 1)]
