"""Solids of revolution: bottles, pawns and other massive ones; vases, bowls, cups and goblets with a true wall."""

from typing import Any

import numpy as np
from jaxtyping import Float

from datagen.shapes import part as parts
from datagen.shapes.geometry.mesh import convex_hull
from datagen.shapes.part import Part, assemble
from datagen.shapes.sampling import Size, longest, rounded
from datagen.shapes.shape import Corners, Shape

PIECE_ERROR = 4.5e-4
"""Metres by which a convex piece of a profile may stick out of it or fall short of it."""


def build(profile: list[list[float]], wall: float = 0.0, floor: float = 0.0) -> Shape:
    """A solid of revolution about z, given its outer corners (r, z) from the bottom to the top, z never falling.

    It has a cavity from z = `floor` on with a wall of horizontal thickness `wall`, unless that is 0. All in metres.
    """
    upside_down = [[r, profile[0][1] + profile[-1][1] - z] for r, z in reversed(profile)]
    same = not wall and np.allclose(upside_down, profile, rtol=0, atol=1e-12)
    return assemble([turned(profile, wall, floor)], "Dinf" if same else "Cinf")


def turned(profile: Corners, wall: float = 0.0, floor: float = 0.0) -> Part:
    """The part that `build` makes a shape of, in the profile's own frame."""
    outer = np.asarray(profile, float)
    if not wall:
        corners = _without_doubles(np.vstack([[0, outer[0, 1]], outer, [0, outer[-1, 1]]]))
        return parts.revolution(corners, _solid_pieces(outer))
    start = np.array([[np.interp(floor, outer[:, 1], outer[:, 0]), floor]])
    above = np.vstack([start, outer[outer[:, 1] > floor]])
    below = np.vstack([outer[outer[:, 1] <= floor], start])
    inner = above - np.array([wall, 0.0])
    corners = np.vstack([[0, outer[0, 1]], outer, inner[::-1], [0, floor]])
    return parts.revolution(corners, _solid_pieces(_without_doubles(below)) + _wall_pieces(above, inner))


def sample_bottle(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a bottle: a body, a shoulder, a neck and a cap."""
    radius, neck = rng.uniform(0.16, 0.26), rng.uniform(0.05, 0.08)
    body, shoulder = rng.uniform(0.45, 0.6), rng.uniform(0.15, 0.25)
    share = np.linspace(0, 1, 7)
    curve = np.stack([radius + (neck - radius) * (3 * share**2 - 2 * share**3), body + shoulder * share], axis=1)
    cap = neck + rng.uniform(0.008, 0.02)
    profile = [[0.88 * radius, 0], [radius, 0.03], *curve, [neck, 0.9], [cap, 0.9], [cap, 1.0]]
    return rounded({"profile": profile}, longest(rng, size))


def sample_pawn(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a pawn: a foot, a slim waist and a ball on top."""
    foot, waist, head = rng.uniform(0.24, 0.34), rng.uniform(0.08, 0.13), rng.uniform(0.16, 0.22)
    share = np.linspace(0, 1, 6)
    body = np.stack([waist + (foot * 0.8 - waist) * (1 - share) ** 2, 0.12 + share * (0.88 - 2 * head)], axis=1)
    start = np.arcsin(waist / head)
    angles = np.linspace(np.pi - start, 0, 9)
    ball = np.stack([head * np.sin(angles), 1 - head + head * np.cos(angles)], axis=1)
    ball[-1, 0] = 0
    profile = [[0.95 * foot, 0], [foot, 0.02], [foot, 0.1], *body[:-1], *ball]
    return rounded({"profile": profile}, longest(rng, size) / max(1, 2 * foot))


def sample_vase(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a vase: a hollow belly between a foot and a mouth."""
    foot, belly, mouth = rng.uniform(0.12, 0.2), rng.uniform(0.25, 0.4), rng.uniform(0.14, 0.28)
    where = rng.uniform(0.3, 0.6)
    z = np.linspace(0, 1, 11)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.minimum(z / where, 1))
    fall = 0.5 - 0.5 * np.cos(np.pi * np.maximum((z - where) / (1 - where), 0))
    radius = foot + (belly - foot) * rise + (mouth - belly) * fall
    parameters = {"profile": np.stack([radius, z], axis=1), "wall": rng.uniform(0.035, 0.05), "floor": 0.06}
    return rounded(parameters, longest(rng, size))


def sample_bowl(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a bowl: an open round wall on a foot."""
    foot, height = rng.uniform(0.18, 0.28), rng.uniform(0.32, 0.5)
    angles = np.linspace(rng.uniform(0.15, 0.3), rng.uniform(1.2, 1.5), 8)
    share = (np.sin(angles) - np.sin(angles[0])) / (np.sin(angles[-1]) - np.sin(angles[0]))
    lift = (np.cos(angles[0]) - np.cos(angles)) / (np.cos(angles[0]) - np.cos(angles[-1]))
    profile = np.stack([foot + (0.5 - foot) * share, height * lift], axis=1)
    parameters = {"profile": profile, "wall": rng.uniform(0.035, 0.06), "floor": 0.05}
    return rounded(parameters, longest(rng, size))


def sample_cup(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a straight tumbler that widens towards its rim."""
    height, low = rng.uniform(0.9, 1.5), rng.uniform(0.3, 0.47)
    profile = [[low, 0.0], [0.5, height]]
    parameters = {"profile": profile, "wall": rng.uniform(0.03, 0.05), "floor": 0.08}
    return rounded(parameters, longest(rng, size) / max(1, height))


def sample_goblet(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a goblet: a hollow calyx on a stem and a foot."""
    foot, stem, rim = rng.uniform(0.2, 0.28), rng.uniform(0.035, 0.05), rng.uniform(0.2, 0.3)
    start = rng.uniform(0.35, 0.5)
    angles = np.linspace(0.15, rng.uniform(1.3, 1.8), 7)
    calyx = np.stack(
        [rim * np.sin(angles) / np.sin(angles).max(), start + (1 - start) * np.linspace(0, 1, 7) ** 1.2], 1
    )
    calyx[0, 0] = max(stem, calyx[0, 0])
    profile = [[foot, 0], [foot, 0.025], [stem * 1.3, 0.06], [stem, 0.12], [stem, start - 0.03], *calyx]
    parameters = {"profile": profile, "wall": rng.uniform(0.025, 0.035), "floor": start + 0.12 * (1 - start)}
    return rounded(parameters, longest(rng, size))


def _solid_pieces(outer: Float[np.ndarray, "corner 2"]) -> list[Float[np.ndarray, "_ 2"]]:
    """Convex polygons between a chain of corners (r, z) and the axis."""
    axis = np.stack([np.zeros(len(outer)), outer[:, 1]], axis=1)
    return _wall_pieces(outer, axis)


def _wall_pieces(
    outer: Float[np.ndarray, "corner 2"], inner: Float[np.ndarray, "corner 2"]
) -> list[Float[np.ndarray, "_ 2"]]:
    """Few convex polygons between two chains of corners at equal heights, each piece as long as the error allows.

    Where a chain is hollow, its piece sticks out of the wall in the middle by as much as it falls short at the ends.
    """
    pieces, start = [], 0
    while start < len(outer) - 1:
        end = start + 1
        while end + 1 < len(outer) and _hollows(outer, inner, start, end + 1).max() <= 2 * PIECE_ERROR:
            end += 1
        if outer[end, 1] > outer[start, 1]:
            rows = slice(start, end + 1)
            shift = 0.5 * _hollows(outer, inner, start, end)
            moved = np.concatenate([outer[rows] - [shift[0], 0.0], inner[rows] + [shift[1], 0.0]])
            pieces.append(convex_hull(np.maximum(moved, [0.0, -np.inf])))
        start = end
    return pieces


def _hollows(
    outer: Float[np.ndarray, "corner 2"], inner: Float[np.ndarray, "corner 2"], start: int, end: int
) -> Float[np.ndarray, "2"]:
    """Depth of a stretch of the outer and of the inner chain below their common convex hull, metres."""
    points = np.concatenate([outer[start : end + 1], inner[start : end + 1]])
    hull = convex_hull(points)
    following = np.roll(hull, -1, axis=0)
    surface = (hull[:, 0] > 0) | (following[:, 0] > 0)
    edges, hull = (following - hull)[surface], hull[surface]
    offsets = points[:, None] - hull
    depth = (edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]) / np.hypot(edges[:, 0], edges[:, 1])
    deepest = np.where(points[:, 0] > 0, depth.min(axis=1), 0.0).reshape(2, -1).max(axis=1)
    return np.maximum(deepest, 0.0)


def _without_doubles(corners: Float[np.ndarray, "corner 2"]) -> Float[np.ndarray, "distinct 2"]:
    return corners[np.r_[True, (np.diff(corners, axis=0) != 0).any(axis=1)]]
