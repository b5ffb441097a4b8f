"""Depth of boxes: tables, walls, bins and shelves, seen exactly or with noise."""

from collections.abc import Sequence

import numpy as np

from datagen.geometry import intrinsics, look_at, pixel_rays

Box = tuple[Sequence[float], Sequence[float]]
"""Least and greatest corner, world frame, metres."""
SIZE = (96, 72)
K = intrinsics(np.radians(65), *SIZE)
TABLE: Box = ((-0.5, -0.6, -0.03), (0.5, 0.6, 0))
FLOOR: Box = ((-4, -4, -0.8), (4, 4, -0.75))
WALL: Box = ((-0.6, -4, -0.75), (-0.55, 4, 2.5))
"""Behind the table, for cameras at positive x."""


def hollow(low: Sequence[float], high: Sequence[float], open_side: int) -> list[Box]:
    """Walls of a box, 1 cm thick, without the upper side (2) or without the front at the greatest x (0)."""
    walls: list[Box] = []
    for axis in range(3):
        for end in (0, 1):
            if (axis, end) == (open_side, 1):
                continue
            corners = [list(low), list(high)]
            corners[1 - end][axis] = corners[end][axis] + (0.01 if end == 0 else -0.01)
            walls.append((corners[0], corners[1]))
    return walls


def things(rng: np.random.Generator, extent: Sequence[float], count: int) -> list[Box]:
    """Boxes of 4 to 12 cm that stand on z = 0 within an extent of x and y."""
    found: list[Box] = []
    for _ in range(count):
        x, y = rng.uniform(-1, 1, 2) * (np.array(extent) - 0.06)
        a, b, height = rng.uniform(0.02, 0.06), rng.uniform(0.02, 0.06), rng.uniform(0.04, 0.12)
        found.append(((x - a, y - b, 0), (x + a, y + b, height)))
    return found


def look(
    boxes: Sequence[Box], position: Sequence[float], target: Sequence[float] = (0, 0, 0), *, noise: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Planar depth in metres, 0 beyond 5 m, and the pose of the camera."""
    pose = look_at(np.array(position, float), np.array(target, float))
    directions = pixel_rays(K, *SIZE) @ pose[:3, :3].T
    depth = np.full(directions.shape[:2], np.inf)
    for low, high in boxes:
        near, far = ((np.array(corner) - pose[:3, 3]) / directions for corner in (low, high))
        enter, leave = np.minimum(near, far).max(axis=-1), np.maximum(near, far).min(axis=-1)
        depth = np.where((enter < leave) & (enter > 0), np.minimum(depth, enter), depth)
    depth = np.minimum(depth, 100)
    noisy = depth + noise * depth**2 * np.random.default_rng(0).normal(size=depth.shape)
    return np.where(depth < 5, noisy, 0).astype(np.float32), pose
