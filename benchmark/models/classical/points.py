"""The points that a clip's cameras saw, and the sizes that go with them."""

import numpy as np
from jaxtyping import Float, Int64

from benchmark.models.interface import Clip
from datagen.geometry import invert_rigid, unproject

VOXEL_PIXELS = 0.5
"""Side of the cells in which points are one, in pixels' width: it bounds what views that overlap cost."""


def scene_points(clip: Clip) -> Float[np.ndarray, "frame view height width 3"]:
    """Points of all pixels, metres, in the frame of the first camera; meaningless where `clip.valid` is False.

    In that frame nothing depends on how the world's axes lie, not even by the corners of voxels.
    """
    first_from_camera = invert_rigid(clip.world_from_camera[0]) @ clip.world_from_camera
    cameras = list(zip(clip.k, first_from_camera, strict=True))
    return np.stack([[unproject(d, *camera) for d, camera in zip(f, cameras, strict=True)] for f in clip.depth])


def viewpoints(clip: Clip) -> Float[np.ndarray, "view 3"]:
    """Where the cameras are, metres, in the frame of `scene_points`."""
    return (invert_rigid(clip.world_from_camera[0]) @ clip.world_from_camera)[:, :3, 3]


def pixel_width(clip: Clip) -> float:
    """Metres that a pixel spans at the clip's median depth; 0 where nothing is valid."""
    return float(np.median(clip.depth[clip.valid]) / np.mean(clip.k[:, 0, 0])) if np.any(clip.valid) else 0.0


def voxels(
    points: Float[np.ndarray, "point 3"], size: float
) -> tuple[Int64[np.ndarray, "voxel"], Int64[np.ndarray, "point"], Int64[np.ndarray, "voxel"]]:
    """One point of every cubic cell of `size` metres that holds some, the cell of each point, and their numbers."""
    _, first, cell, counts = np.unique(
        cell_ids(points, size), return_index=True, return_inverse=True, return_counts=True
    )
    return first, cell, counts


def cell_ids(points: Float[np.ndarray, "point 3"], size: float) -> Int64[np.ndarray, "point"]:
    """One integer for each cubic cell of that many metres; 21 bits an axis hold 8 km of cells of 4 mm."""
    x, y, z = (np.floor(points / size).astype(np.int64) & 0x1FFFFF).T
    return (x << 42) | (y << 21) | z
