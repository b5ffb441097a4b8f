"""Voxels as shaded cubes, and lines, in perspective."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

SMOOTH = 2
"""Pictures are drawn so many times as large, and made smaller at the end."""
LIGHT = np.array([0.35, -0.5, 0.8])
"""Towards it, world frame."""


@dataclass(frozen=True, eq=False)
class Eye:
    """A pinhole camera for a square picture."""

    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    """World from camera, OpenCV axes."""
    focal: float
    """In widths of the picture."""

    def project(self, points: Float[np.ndarray, "*shape 3"], size: int) -> Float[np.ndarray, "*shape 2"]:
        """Pixels of a picture of that size."""
        local = (points - self.position) @ self.rotation
        return size * (0.5 + self.focal * local[..., :2] / np.maximum(local[..., 2:], 1e-3))


@dataclass(frozen=True, eq=False)
class Cubes:
    """Some that are turned alike."""

    centers: Float[np.ndarray, "cube 3"]
    rotation: Float[np.ndarray, "3 3"]
    """World from cube."""
    edge: float
    colours: Float[np.ndarray, "cube 3"]
    """0..1."""
    opacity: Float[np.ndarray, " cube"]
    """0..1."""


@dataclass(frozen=True, eq=False)
class Line:
    """From one point to another."""

    ends: Float[np.ndarray, "2 3"]
    colour: tuple[int, int, int]
    width: int = 2


def look_at(
    target: Float[np.ndarray, "3"], direction: tuple[float, float, float], *, distance: float, focal: float
) -> Eye:
    """From the target's side that `direction` points to; z is up."""
    back = np.array(direction) / np.linalg.norm(direction)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return Eye(target + distance * back, np.stack([right, -np.cross(back, right), -back], axis=1), focal)


def draw(cubes: Sequence[Cubes], eye: Eye, *, size: int, below: Sequence[Line] = (), over: Sequence[Line] = ()):
    """A picture on white: lines, cubes over them from far to near, and further lines over these."""
    canvas = Image.new("RGB", (SMOOTH * size, SMOOTH * size), (255, 255, 255))
    pen = ImageDraw.Draw(canvas, "RGBA")
    _draw_lines(pen, below, eye, size)
    sides = [side for group in cubes for side in _sides(group, eye, SMOOTH * size)]
    for _, corners, colour in sorted(sides, key=lambda side: -side[0]):
        pen.polygon(corners, fill=colour)
    _draw_lines(pen, over, eye, size)
    return canvas.resize((size, size), Image.Resampling.LANCZOS)


def _draw_lines(pen: ImageDraw.ImageDraw, lines: Sequence[Line], eye: Eye, size: int) -> None:
    for line in lines:
        ends = eye.project(line.ends, SMOOTH * size)
        pen.line([tuple(end) for end in ends.tolist()], fill=line.colour, width=SMOOTH * line.width)


def _sides(cubes: Cubes, eye: Eye, size: int) -> list[tuple[float, list[tuple[float, ...]], tuple[int, ...]]]:
    """Distance, corners in the picture and colour of the sides that face the eye."""
    found = []
    for axis in range(3):
        across, along = (cubes.rotation[:, (axis + turn) % 3] for turn in (1, 2))
        square = cubes.edge / 2 * np.stack([across + along, across - along, -across - along, along - across])
        for sign in (-1, 1):
            normal = sign * cubes.rotation[:, axis]
            middles = cubes.centers + cubes.edge / 2 * normal
            seen = (eye.position - middles) @ normal > 0
            shade = 0.72 + 0.28 * (normal @ LIGHT) / np.linalg.norm(LIGHT)
            corners = eye.project(middles[seen, None] + square, size)
            colours = np.concatenate([shade * cubes.colours[seen], cubes.opacity[seen, None]], axis=1)
            levels = (255 * colours.clip(0, 1)).astype(int)
            distances = np.linalg.norm(cubes.centers[seen] - eye.position, axis=1)
            found += [
                (distance, [tuple(corner) for corner in quad], tuple(level))
                for distance, quad, level in zip(distances.tolist(), corners.tolist(), levels.tolist(), strict=True)
            ]
    return found
