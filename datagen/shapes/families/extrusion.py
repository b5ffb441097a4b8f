"""Prisms over polygons that are cut into convex pieces by construction."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from datagen.shapes import part as parts
from datagen.shapes.part import assemble
from datagen.shapes.sampling import Size, draw, longest, rounded
from datagen.shapes.shape import Corners, Shape

STANDING = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
"""Turns a polygon's y axis, its axis of symmetry, into the object's z axis."""


def build_prism(corners: int, radius: float, height: float) -> Shape:
    """A prism along z over a regular polygon with a corner on the x axis; `radius` is that of its corners."""
    return assemble([parts.extrusion(_regular(corners, radius), [range(corners)], height)], f"D{corners}")


def build_star(points: int, outer_radius: float, inner_radius: float, height: float) -> Shape:
    """A prism along z over a star with a tip on the x axis."""
    polygon = np.empty((2 * points, 2))
    polygon[::2] = _regular(points, outer_radius)
    polygon[1::2] = _regular(points, inner_radius, 0.5)
    tips = [[2 * i - 1, 2 * i, 2 * i + 1] for i in range(points)]
    pieces = [[k % (2 * points) for k in tip] for tip in tips]
    return assemble([parts.extrusion(polygon, [*pieces, range(1, 2 * points, 2)], height)], f"D{points}")


def build_gear(teeth: int, outer_radius: float, inner_radius: float, tooth_share: float, height: float) -> Shape:
    """A prism along z over a gear wheel, the middle of a tooth on the x axis; radii are those of corners.

    `tooth_share` is the angle that a tooth takes up at its tip as a share of the pitch; at its root it is larger.
    """
    shares = np.array([-0.55 - 0.2 * tooth_share, -0.5, 0.5, 0.55 + 0.2 * tooth_share]) * tooth_share
    radii = np.array([inner_radius, outer_radius, outer_radius, inner_radius])
    angles = 2 * np.pi * (np.arange(teeth)[:, None] + shares) / teeth
    polygon = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1).reshape(-1, 2)
    hub = [k for i in range(teeth) for k in (4 * i, 4 * i + 3)]
    pieces = [*([4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 3] for i in range(teeth)), hub]
    return assemble([parts.extrusion(polygon, pieces, height)], f"D{teeth}")


def build_cross(length_x: float, length_y: float, width: float, height: float) -> Shape:
    """A prism along z over a plus sign with bars of equal width."""
    x, y, w = 0.5 * length_x, 0.5 * length_y, 0.5 * width
    right, top, left = [[x, -w], [x, w], [w, w]], [[w, y], [-w, y], [-w, w]], [[-x, w], [-x, -w], [-w, -w]]
    polygon = [*right, *top, *left, [-w, -y], [w, -y], [w, -w]]
    pieces = [[2, 5, 8, 11], [0, 1, 2, 11], [2, 3, 4, 5], [5, 6, 7, 8], [8, 9, 10, 11]]
    return assemble([parts.extrusion(polygon, pieces, height)], "D4" if length_x == length_y else "D2")


def build_tee(bar: float, stem: float, thickness: float, height: float) -> Shape:
    """A T that stands along z: a bar of the given length on a stem, both `thickness` wide, `height` deep along y."""
    b, t = 0.5 * bar, 0.5 * thickness
    top = stem + thickness
    polygon = [[-t, 0], [t, 0], [t, stem], [b, stem], [b, top], [-b, top], [-b, stem], [-t, stem]]
    return _standing(polygon, [[0, 1, 2, 7], [4, 5, 6, 7, 2, 3]], height, "C2")


def build_channel(width: float, depth: float, thickness: float, height: float) -> Shape:
    """A U that stands along z: outer `width`, `depth` along z, walls of `thickness`, `height` along y."""
    w, t = 0.5 * width, thickness
    polygon = [[-w, 0], [w, 0], [w, depth], [w - t, depth], [w - t, t], [t - w, t], [t - w, depth], [-w, depth]]
    pieces = [[0, 1, 4, 5], [1, 2, 3, 4], [0, 5, 6, 7]]
    return _standing(polygon, pieces, height, "C2")


def build_arrow(length: float, head_length: float, head_width: float, shaft_width: float, height: float) -> Shape:
    """An arrow that points along +z, `height` deep along y."""
    s, h, k = 0.5 * shaft_width, 0.5 * head_width, length - head_length
    polygon = [[-s, 0], [s, 0], [s, k], [h, k], [0, length], [-h, k], [-s, k]]
    return _standing(polygon, [[0, 1, 2, 6], [4, 5, 6, 2, 3]], height, "C2")


def build_angle(arm_x: float, arm_z: float, thickness: float, height: float) -> Shape:
    """An L of two arms along +x and +z, `height` deep along y; with equal arms, z is the line between them."""
    t = thickness
    polygon = np.array([[0, 0], [arm_x, 0], [arm_x, t], [t, t], [t, arm_z], [0, arm_z]])
    pieces = [[0, 1, 2, 3], [0, 3, 4, 5]]
    if arm_x != arm_z:
        return _standing(polygon, pieces, height, "C1")
    diagonal = np.sqrt(0.5) * np.array([[1.0, 1.0], [-1.0, 1.0]])
    return _standing(polygon @ diagonal, pieces, height, "C2")


def sample_prism(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a prism with three to eight corners, from tiles to pencils."""
    corners = int(rng.choice([3, 5, 6, 8]))
    height = rng.uniform(0.4, 3)
    extent = np.ptp(_regular(corners, 1.0), axis=0).max()
    return rounded({"corners": corners, "radius": 1.0, "height": height}, longest(rng, size) / max(extent, height))


def sample_star(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a star with four to seven points."""
    points, inner, height = int(rng.integers(4, 8)), rng.uniform(0.42, 0.6), rng.uniform(0.3, 0.9)
    parameters = {"points": points, "outer_radius": 1.0, "inner_radius": inner, "height": height}
    return rounded(parameters, longest(rng, size) / np.ptp(_regular(points, 1.0), axis=0).max())


def sample_gear(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a gear wheel with six to ten teeth."""
    teeth, height = int(rng.integers(6, 11)), rng.uniform(0.3, 0.9)
    share = round(rng.uniform(0.4, 0.5), 6)
    lengths = {"outer_radius": 1.0, "inner_radius": rng.uniform(0.7, 0.8), "height": height}
    tips = np.concatenate([_regular(teeth, 1.0, 0.5 * share), _regular(teeth, 1.0, -0.5 * share)])
    scaled = rounded(lengths, longest(rng, size) / np.ptp(tips, axis=0).max())
    return {"teeth": teeth, "tooth_share": share, **scaled}


def sample_cross(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a plus sign with equal or different bars."""
    other = 1.0 if rng.uniform() < 0.5 else rng.uniform(0.6, 0.95)
    parameters = {"length_x": 1.0, "length_y": other, "width": rng.uniform(0.2, 0.4), "height": rng.uniform(0.2, 0.6)}
    return rounded(parameters, longest(rng, size))


def sample_tee(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a letter T."""
    thickness, stem = rng.uniform(0.2, 0.35), rng.uniform(0.5, 1.0)
    parameters = {"bar": 1.0, "stem": stem, "thickness": thickness, "height": rng.uniform(0.2, 0.7)}
    return rounded(parameters, longest(rng, size) / max(1, stem + thickness))


def sample_channel(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a letter U."""
    depth = rng.uniform(0.5, 1.1)
    parameters = {"width": 1.0, "depth": depth, "thickness": rng.uniform(0.15, 0.28), "height": rng.uniform(0.25, 0.9)}
    return rounded(parameters, longest(rng, size) / max(1, depth))


def sample_arrow(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw an arrow with a broad head."""
    parameters = draw(rng, length=1.0, head_length=(0.35, 0.5), head_width=(0.55, 0.85), shaft_width=(0.2, 0.35))
    return rounded(parameters | draw(rng, height=(0.2, 0.5)), longest(rng, size))


def sample_angle(rng: np.random.Generator, size: Size) -> dict[str, Any]:
    """Draw a letter L with arms of different lengths."""
    other = rng.uniform(0.5, 0.95)
    parameters = {"arm_x": other, "arm_z": 1.0, "thickness": rng.uniform(0.15, 0.3), "height": rng.uniform(0.2, 0.8)}
    return rounded(parameters, longest(rng, size))


def _standing(polygon: Corners, pieces: Sequence[Sequence[int]], height: float, symmetry: str) -> Shape:
    return assemble([parts.extrusion(polygon, pieces, height).placed([0, 0, 0], STANDING)], symmetry)


def _regular(corners: int, radius: float, shift: float = 0.0) -> Float[np.ndarray, "corner 2"]:
    """Corners of a regular polygon, turned by `shift` of the angle between neighbours from the x axis."""
    angles = 2 * np.pi * (np.arange(corners) + shift) / corners
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
