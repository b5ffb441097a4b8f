"""Shared parts of models without training: their base, surface points of a clip, and a limit on labels."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int64

from benchmark.models.interface import LARGEST_LABEL, Clip
from datagen.geometry import invert_rigid

VOXEL_PIXELS = 0.5
"""Side of the cells in which points are merged, in pixel widths; it bounds the cost of overlapping views."""


def scene_points(clip: Clip) -> Float[np.ndarray, "frame view height width 3"]:
    """Points of all pixels, metres, in the frame of the first camera; meaningless where `clip.valid` is False.

    In that frame nothing depends on the world's axes, not even the corners of voxels.
    """
    return clip.points(_first_from_camera(clip))


def viewpoints(clip: Clip) -> Float[np.ndarray, "view 3"]:
    """Camera centres, metres, in the frame of `scene_points`."""
    return _first_from_camera(clip)[:, :3, 3]


def _first_from_camera(clip: Clip) -> Float[np.ndarray, "view 4 4"]:
    return invert_rigid(clip.world_from_camera[0]) @ clip.world_from_camera


def pixel_width(clip: Clip) -> float:
    """Width of a pixel in metres at the clip's median depth; 0 if no pixel is valid."""
    return float(np.median(clip.depth[clip.valid]) / np.mean(clip.k[:, 0, 0])) if np.any(clip.valid) else 0.0


def voxels(
    points: Float[np.ndarray, "point 3"], size: float
) -> tuple[Int64[np.ndarray, "voxel"], Int64[np.ndarray, "point"], Int64[np.ndarray, "voxel"]]:
    """Group points by cubic cells of `size` metres: one point per cell, the cell of each point, and points per cell."""
    _, first, cell, counts = np.unique(
        cell_ids(points, size), return_index=True, return_inverse=True, return_counts=True
    )
    return first, cell, counts


def cell_ids(points: Float[np.ndarray, "point 3"], size: float) -> Int64[np.ndarray, "point"]:
    """Number the cubic cells of `size` metres; 21 bits per axis suffice for 8 km of cells of 4 mm."""
    x, y, z = (np.floor(points / size).astype(np.int64) & 0x1FFFFF).T
    return (x << 42) | (y << 21) | z


@dataclass
class Untrained:
    """Base of segmenters that learn nothing; their fields are their options."""

    seed: int = field(default=0, init=False)
    """Set by `fit`."""

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Keep the seed; there is nothing to learn."""
        self.seed = seed


def keep_largest(labels: Int64[np.ndarray, "*pixel"], count: int = LARGEST_LABEL) -> Int64[np.ndarray, "*pixel"]:
    """Relabel the `count` largest segments from 1, in their old order; the others join segment 0."""
    sizes = np.bincount(labels.ravel(), minlength=1)
    sizes[0] = 0
    largest = np.argsort(-sizes, kind="stable")[: min(count, np.count_nonzero(sizes))]
    new = np.zeros(len(sizes), np.int64)
    new[np.sort(largest)] = np.arange(1, len(largest) + 1)
    return new[labels]
