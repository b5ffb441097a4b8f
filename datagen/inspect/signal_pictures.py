"""Pictures of optional signals: flow as colours, normals, object coordinates and tracked points."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Integer, UInt8
from PIL import Image, ImageDraw

from datagen.schema import COORDINATE_SCALE, NORMAL_SCALE, SHOWN, SceneRecord

STILL = 0.25
"""Length of flow that is drawn white, pixels."""

Rgb = UInt8[np.ndarray, "height width 3"]


def colored_flow(flow: Float[np.ndarray, "height width 2"], most: float) -> Rgb:
    """Draw flow as colours: the hue is the direction (red right, blue down left), white is still, `most` is vivid."""
    motion = flow.astype(np.float64)
    length = np.sqrt(np.sum(motion * motion, axis=-1))
    turn = np.arctan2(motion[..., 1], motion[..., 0]) / (2 * np.pi)
    hues = np.clip(np.abs(6 * ((turn[..., None] + np.array([0, 1 / 3, 2 / 3])) % 1) - 3) - 1, 0, 1)
    vivid = np.clip((length - STILL) / max(most - STILL, 1e-9), 0, 1)[..., None]
    return (255 * (1 - vivid * (1 - hues))).astype(np.uint8)


def flow_picture(record: SceneRecord, name: str, frame: int, view: int) -> Rgb:
    """Draw `flow/forward` or `flow/backward` of one image; hidden points are dimmed."""
    picture = colored_flow(record[f"flow/{name}"][frame, view], longest_flow(record))
    hidden = record[f"flow/{name}_occlusion"][frame, view] != SHOWN
    return np.where(hidden[..., None], picture // 2, picture)


def longest_flow(record: SceneRecord) -> float:
    """Length that only one in a thousand pixels exceeds, pixels."""
    flow = record["flow/forward"].astype(np.float64)
    return max(1.0, float(np.quantile(np.sqrt(np.sum(flow * flow, axis=-1)), 0.999)))


def colored_normals(normals: Integer[np.ndarray, "height width 3"]) -> Rgb:
    """Draw normals as colours: red right, green up, blue towards the camera; black without a surface."""
    direction = normals / NORMAL_SCALE * np.array([1, -1, -1])
    return np.where(np.any(normals != 0, axis=-1, keepdims=True), 127.5 + 127.5 * direction, 0).astype(np.uint8)


def colored_coordinates(coordinates: Integer[np.ndarray, "height width 3"]) -> Rgb:
    """Draw object coordinates as red, green and blue."""
    return (255.0 / COORDINATE_SCALE * coordinates).astype(np.uint8)


def signal_legend(record: SceneRecord) -> Iterator[tuple[str, Rgb, tuple[str, ...]]]:
    """Explain the colours of each stored signal: its name, a row of colours, and a word for each of them."""
    if "flow/forward" in record:
        # The last two colours are those of hidden points; where there is no other frame, the flow is 0 and none shows.
        motion = np.array([[(1, 0), (0, 1), (-1, 0), (0, -1), (0, 0), (1, 0), (0, 0)]], np.float64)
        divisor = np.array([1, 1, 1, 1, 1, 2, 2], np.uint8)[None, :, None]
        words = ("right", "down", "left", "up", "still", "right, hidden", "no such frame, or still and hidden")
        yield "flow:", colored_flow(motion, most=1.0) // divisor, words
    if "normals" in record:
        directions = np.array([[(NORMAL_SCALE, 0, 0), (0, -NORMAL_SCALE, 0), (0, 0, -NORMAL_SCALE)]])
        yield "normals:", colored_normals(directions), ("right", "up", "to the camera")
    if "object_coordinates" in record:
        yield "coordinates:", colored_coordinates(COORDINATE_SCALE * np.eye(3, dtype=int)[None]), ("x", "y", "z")


TRACKS_DRAWN, TAIL = 64, 6
"""Most points drawn in a picture, and frames of their paths."""


def tracks_picture(record: SceneRecord, frame: int, view: int) -> Rgb:
    """Draw the first tracked points with their latest paths over the dimmed colour image; hidden points are hollow."""
    picture = Image.fromarray(record["rgb"][frame, view] // 2 + 64)
    draw = ImageDraw.Draw(picture)
    places, occluded = record["tracks/position_2d"][view], record["tracks/occluded"][view]
    chosen = np.linspace(0, len(places) - 1, min(TRACKS_DRAWN, len(places))).astype(int)
    for number, point in enumerate(chosen):
        hue = (number * 0.618034 + np.array([0, 1 / 3, 2 / 3])) % 1
        color = tuple((60 + 195 * np.clip(np.abs(6 * hue - 3) - 1, 0, 1)).astype(int).tolist())
        path = places[point, max(0, frame - TAIL) : frame + 1]
        if len(path) > 1:
            draw.line([tuple(place) for place in (path - 0.5).tolist()], fill=color)
        x, y = (path[-1] - 0.5).tolist()
        draw.ellipse((x - 1, y - 1, x + 1, y + 1), outline=color, fill=None if occluded[point, frame] else color)
    return np.asarray(picture)
