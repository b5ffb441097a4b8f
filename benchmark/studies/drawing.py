"""Voxels as shaded cubes, and lines, in perspective; sheets of labelled pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw

TILE = 200
"""Width and height of a picture, pixels."""
MARGIN, LINE = 92, 16
"""Pixels for row names at the left and for column titles at the top."""
SIDE = (0.9, -0.35, 0.55)
"""Viewing direction of pictures that no camera took: from the target towards the viewer."""
GREY, BLACK = (205, 205, 205), (60, 60, 60)
_SUPERSAMPLING = 2
_LIGHT = np.array([0.35, -0.5, 0.8])
"""Direction towards the light, world frame."""

Colour = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Eye:
    """A pinhole camera for a square picture."""

    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    """World from camera, OpenCV axes."""
    focal: float
    """Focal length in widths of the picture."""

    def project(self, points: Float[np.ndarray, "*shape 3"], size: int) -> Float[np.ndarray, "*shape 2"]:
        """Project world points to pixels of a picture of this size."""
        local = (points - self.position) @ self.rotation
        return size * (0.5 + self.focal * local[..., :2] / np.maximum(local[..., 2:], 1e-3))


@dataclass(frozen=True, eq=False)
class Cubes:
    """Equal cubes that share one rotation."""

    centers: Float[np.ndarray, "cube 3"]
    rotation: Float[np.ndarray, "3 3"]
    """World from cube."""
    edge: float
    colours: Float[np.ndarray, "cube 3"]
    """RGB from 0 to 1."""
    opacity: Float[np.ndarray, " cube"]
    """From 0 to 1."""


@dataclass(frozen=True, eq=False)
class Segment:
    """A line between two world points."""

    ends: Float[np.ndarray, "2 3"]
    colour: Colour
    width: int = 2


def look_at(
    target: Float[np.ndarray, "3"], direction: tuple[float, float, float], *, distance: float, focal: float
) -> Eye:
    """View a target from the side that `direction` points to; z is up."""
    back = np.array(direction) / np.linalg.norm(direction)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return Eye(target + distance * back, np.stack([right, -np.cross(back, right), -back], axis=1), focal)


def draw(
    cubes: Sequence[Cubes], eye: Eye, *, size: int = TILE, below: Sequence[Segment] = (), over: Sequence[Segment] = ()
) -> Image.Image:
    """Draw lines on white, cubes over them from far to near, and further lines on top."""
    canvas = Image.new("RGB", (_SUPERSAMPLING * size, _SUPERSAMPLING * size), (255, 255, 255))
    pen = ImageDraw.Draw(canvas, "RGBA")
    _draw_lines(pen, below, eye, size)
    faces = [face for group in cubes for face in _visible_faces(group, eye, _SUPERSAMPLING * size)]
    for _, corners, colour in sorted(faces, key=lambda face: -face[0]):
        pen.polygon(corners, fill=colour)
    _draw_lines(pen, over, eye, size)
    return canvas.resize((size, size), Image.Resampling.LANCZOS)


def wire_box(
    center: Float[np.ndarray, "3"], rotation: Float[np.ndarray, "3 3"], half: Float[np.ndarray, "3"], colour: Colour
) -> list[Segment]:
    """Edges of a box, given half of its side lengths."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half @ rotation.T + center
    # The two corners of an edge differ in one coordinate, which is one bit of their indices.
    edges = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return [Segment(corners[list(edge)], colour) for edge in edges]


def sheet(titles: Sequence[str], rows: Mapping[str, Sequence[Image.Image]]) -> Image.Image:
    """Arrange pictures in named rows below column titles."""
    canvas = Image.new("RGB", (MARGIN + len(titles) * TILE, LINE + len(rows) * TILE), (255, 255, 255))
    pen = ImageDraw.Draw(canvas)
    for column, title in enumerate(titles):
        pen.text((MARGIN + column * TILE + 4, 2), title, fill=BLACK)
    for row, (name, tiles) in enumerate(rows.items()):
        pen.multiline_text((4, LINE + row * TILE + TILE // 2 - 8), name, fill=BLACK)
        for column, tile in enumerate(tiles):
            canvas.paste(tile, (MARGIN + column * TILE, LINE + row * TILE))
    return canvas


def first_to_last(length: int, count: int = 4) -> list[int]:
    """Choose at most `count` indices at equal distances, the first and the last among them."""
    return np.linspace(0, length - 1, min(count, length)).round().astype(int).tolist()


def _draw_lines(pen: ImageDraw.ImageDraw, lines: Sequence[Segment], eye: Eye, size: int) -> None:
    for line in lines:
        ends = eye.project(line.ends, _SUPERSAMPLING * size)
        pen.line([tuple(end) for end in ends.tolist()], fill=line.colour, width=_SUPERSAMPLING * line.width)


def _visible_faces(cubes: Cubes, eye: Eye, size: int) -> list[tuple[float, list[tuple[float, ...]], tuple[int, ...]]]:
    """Distance, corners in the picture and colour of the faces that face the eye."""
    faces = []
    for axis in range(3):
        across, along = (cubes.rotation[:, (axis + turn) % 3] for turn in (1, 2))
        square = cubes.edge / 2 * np.stack([across + along, across - along, -across - along, along - across])
        for sign in (-1, 1):
            normal = sign * cubes.rotation[:, axis]
            middles = cubes.centers + cubes.edge / 2 * normal
            seen = (eye.position - middles) @ normal > 0
            shade = 0.72 + 0.28 * (normal @ _LIGHT) / np.linalg.norm(_LIGHT)
            corners = eye.project(middles[seen, None] + square, size)
            colours = np.concatenate([shade * cubes.colours[seen], cubes.opacity[seen, None]], axis=1)
            levels = (255 * colours.clip(0, 1)).astype(int)
            distances = np.linalg.norm(cubes.centers[seen] - eye.position, axis=1)
            faces += [
                (distance, [tuple(corner) for corner in quad], tuple(level))
                for distance, quad, level in zip(distances.tolist(), corners.tolist(), levels.tolist(), strict=True)
            ]
    return faces
