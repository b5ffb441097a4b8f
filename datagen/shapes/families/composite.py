"""Shapes composed of a few primitives: dumbbells, hammers, brackets, jacks, towers, snowmen."""

from itertools import pairwise
from typing import Any

import numpy as np

from datagen.shapes import part as parts
from datagen.shapes.families.primitives import odd_last
from datagen.shapes.geometry import mass as masses
from datagen.shapes.geometry.mass import Mass
from datagen.shapes.part import assemble
from datagen.shapes.sampling import Size, longest, rounded
from datagen.shapes.shape import Shape

_FLIPPED = np.diag([1.0, -1.0, -1.0])


def build_dumbbell(ball_radius: float, bar_radius: float, distance: float) -> Shape:
    """Two balls on a bar along z; `distance` is that of their centres, in metres as all lengths."""
    depth = 0.9 * np.sqrt(ball_radius**2 - bar_radius**2)
    bar = parts.cylinder(bar_radius, distance - 2 * depth)
    ball = parts.sphere(ball_radius)
    shift = np.array([0, 0, 0.5 * distance])
    lower = _bar_in_ball(bar_radius, ball_radius, depth)
    common = [lower.placed(np.eye(3), -shift), lower.placed(_FLIPPED, shift)]
    return assemble([bar, ball.placed(shift), ball.placed(-shift)], "Dinf", overlap=common)


def build_weight(disc_radius: float, disc_height: float, bar_radius: float, bar_length: float, corners: int) -> Shape:
    """Two discs, or prisms over regular polygons, on a bar along z; `corners` is 0 for round discs."""
    if corners:
        angles = 2 * np.pi * np.arange(corners) / corners
        polygon = disc_radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        disc = parts.extrusion(polygon, [range(corners)], disc_height)
    else:
        disc = parts.cylinder(disc_radius, disc_height)
    shift = np.array([0, 0, 0.5 * (bar_length + disc_height)])
    symmetry = f"D{corners}" if corners else "Dinf"
    return assemble([parts.cylinder(bar_radius, bar_length), disc.placed(shift), disc.placed(-shift)], symmetry)


def build_hammer(handle_radius: float, handle_length: float, head_size: list[float]) -> Shape:
    """A round handle along z with a box as head, `head_size` its full sides along x, y, z."""
    handle = parts.cylinder(handle_radius, handle_length)
    head = parts.box(head_size).placed([0, 0, 0.5 * (handle_length + head_size[2])])
    return assemble([handle, head], "C4" if head_size[0] == head_size[1] else "C2")


def build_bracket(base: float, upright: float, width: float, thickness: float, gusset: float) -> Shape:
    """A plate of length `base` along x, another one of height `upright` along z, and a triangular web between them.

    `gusset` is the web's leg. Both plates are `width` along y; all lengths are metres.
    """
    web = parts.extrusion([[0, 0], [gusset, 0], [0, gusset]], [[0, 1, 2]], thickness)
    standing = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
    pieces = [
        parts.box((base, width, thickness)).placed([0.5 * base, 0, 0.5 * thickness]),
        parts.box((thickness, width, upright - thickness)).placed([0.5 * thickness, 0, 0.5 * (upright + thickness)]),
        web.placed([thickness, 0, thickness], standing),
    ]
    if base != upright:
        return assemble(pieces, "C1")
    half = np.sqrt(0.5)
    diagonal = np.array([[half, 0, -half], [0, 1, 0], [half, 0, half]])
    return assemble([piece.placed([0, 0, 0], diagonal) for piece in pieces], "C2")


def build_jack(lengths: list[float], width: float) -> Shape:
    """Three square bars that cross at right angles, of full lengths along x, y, z in metres.

    Where only two lengths are equal, the third lies along z.
    """
    x, y, z = odd_last(lengths)
    arms = [parts.box((x, width, width))]
    for axis, length in ((1, y), (2, z)):
        reach = 0.5 * (length - width)
        size = [width, width, width]
        size[axis] = reach
        shift = np.eye(3)[axis] * 0.5 * (width + reach)
        arms += [parts.box(size).placed(shift), parts.box(size).placed(-shift)]
    symmetry = "O" if x == y == z else "D4" if x == y else "D2"
    return assemble(arms, symmetry)


def build_tower(base: float, block_height: float, radius: float, drum_height: float, tip_height: float) -> Shape:
    """A square block, a drum and a cone on top of each other along z; `base` is the block's side, metres."""
    drum = np.array([0, 0, 0.5 * (block_height + drum_height)])
    tip = np.array([0, 0, 0.5 * block_height + drum_height + 0.5 * tip_height])
    block = parts.box((base, base, block_height))
    pieces = [block, parts.cylinder(radius, drum_height).placed(drum)]
    return assemble([*pieces, parts.frustum(radius, 0.0, tip_height).placed(tip)], "C4")


def build_snowman(radii: list[float], distances: list[float]) -> Shape:
    """Balls along z, each overlapping the one before; `distances` are those of neighbouring centres, metres."""
    centers = np.concatenate([[0.0], np.cumsum(distances)])
    balls = [parts.sphere(r).placed([0, 0, z]) for r, z in zip(radii, centers, strict=True)]
    lenses = [
        _lens(low, high, distance).placed(np.eye(3), np.array([0, 0, z]))
        for (low, high), distance, z in zip(pairwise(radii), distances, centers[:-1], strict=True)
    ]
    symmetry = "Dinf" if radii == radii[::-1] and distances == distances[::-1] else "Cinf"
    return assemble(balls, symmetry, overlap=lenses)


def sample_dumbbell(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a dumbbell with balls at both ends."""
    ball, bar = rng.uniform(0.14, 0.21), rng.uniform(0.045, 0.09)
    return rounded({"ball_radius": ball, "bar_radius": bar, "distance": 1 - 2 * ball}, longest(rng, size))


def sample_weight(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a weight with round or hexagonal discs at both ends."""
    disc, height = rng.uniform(0.2, 0.38), rng.uniform(0.14, 0.26)
    lengths = {"disc_radius": disc, "disc_height": height, "bar_radius": rng.uniform(0.06, 0.11)}
    corners = int(rng.choice([0, 0, 6, 8]))
    return rounded({**lengths, "bar_length": 1 - 2 * height, "corners": corners}, longest(rng, size))


def sample_hammer(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a mallet."""
    head = np.array([rng.uniform(0.4, 0.7), rng.uniform(0.18, 0.3), rng.uniform(0.18, 0.3)])
    parameters = {"handle_radius": rng.uniform(0.04, 0.07), "handle_length": 1 - head[2], "head_size": head}
    return rounded(parameters, longest(rng, size))


def sample_bracket(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a shelf bracket with plates of different lengths."""
    base = rng.uniform(0.55, 0.95)
    parameters = {"base": base, "upright": 1.0, "width": rng.uniform(0.35, 0.7), "thickness": rng.uniform(0.08, 0.14)}
    return rounded({**parameters, "gusset": base * rng.uniform(0.4, 0.7)}, longest(rng, size))


def sample_jack(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw three crossing bars; they are equal in half of the cases."""
    lengths = [1.0, 1.0, 1.0] if rng.uniform() < 0.5 else [1.0, *rng.uniform(0.6, 0.95, 2)]
    return rounded({"lengths": lengths, "width": rng.uniform(0.2, 0.35)}, longest(rng, size))


def sample_tower(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a toy tower."""
    heights = rng.uniform(0.6, 1, 3)
    base = rng.uniform(0.4, 0.9)
    names = ("block_height", "drum_height", "tip_height")
    parameters = {"base": base, "radius": 0.5 * base * rng.uniform(0.6, 0.98)}
    parameters |= dict(zip(names, heights, strict=True))
    return rounded(parameters, longest(rng, size) / heights.sum())


def sample_snowman(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a snowman of two or three balls."""
    radii = [1.0, *np.cumprod(rng.uniform(0.65, 0.85, int(rng.integers(1, 3))))]
    distances = [0.85 * (a + b) for a, b in pairwise(radii)]
    length = radii[0] + sum(distances) + radii[-1]
    return rounded({"radii": radii, "distances": distances}, longest(rng, size) / length)


def _bar_in_ball(bar: float, ball: float, depth: float) -> Mass:
    """Mass of the intersection of a bar along z, starting at z = depth, and a ball around the origin."""
    rim = np.sqrt(ball**2 - bar**2)
    inside = masses.of_revolution(np.array([[0, depth], [bar, depth], [bar, rim], [0, rim]]))
    return masses.total([inside, masses.of_ball_slice(ball, rim, ball)])


def _lens(low: float, high: float, distance: float) -> Mass:
    """Mass of the intersection of a ball around the origin and one at z = distance."""
    plane = 0.5 * (distance + (low**2 - high**2) / distance)
    upper = masses.of_ball_slice(high, -high, plane - distance)
    return masses.total([masses.of_ball_slice(low, plane, low), upper.placed(np.eye(3), np.array([0, 0, distance]))])
