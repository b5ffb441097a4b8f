"""The geometric baseline: take away the largest plane, cluster what stands on it.

It needs no training and no colour, and sees every frame by itself, so that its labels keep no identity over time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64
from sklearn.cluster import DBSCAN

from benchmark.baselines.plane import Plane, fit_plane
from benchmark.interface import Clip, Prediction
from datagen.geometry import unproject


@dataclass(frozen=True)
class PlaneDbscanConfig:
    """Chosen by MSC-FG on the validation splits of `moving` and `noisy`."""

    least_height: float = 0.001
    """Metres above the plane from which on a point belongs to an object; more cuts off the feet of objects."""
    noise_factor: float = 3.0
    """Where the sensor is noisy, that height rises to so many standard deviations of the plane's own points."""
    reach: float = 0.02
    """DBSCAN's eps, metres: points closer than this are neighbours; more merges objects, less breaks them up."""
    reach_pixels: float = 3.0
    """In coarse images that reach grows to this many pixels' width on the table, or surfaces would fall apart."""
    least_neighbours: int = 3
    """DBSCAN's min_samples, pixels, the point's own included: objects of a few pixels still make a cluster."""
    voxel: float = 0.004
    """Metres; points in one such cell are clustered as one, which bounds the cost of large images and many views."""


class PlaneDbscan:
    """RANSAC plane removal and DBSCAN on the remaining points; implements `Segmenter`."""

    def __init__(self, config: PlaneDbscanConfig = PlaneDbscanConfig()):
        self.config = config
        self._seed = 0

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Keep the seed; there is nothing to learn."""
        self._seed = seed

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, what lies below it, holes and lone points; clusters count from 1 in every frame."""
        points = world_points(clip)
        labels = np.zeros(clip.depth.shape, np.int64)
        plane = fit_plane(points[clip.valid], np.random.default_rng(self._seed))
        if plane is not None:
            standing = clip.valid & self._above(plane.oriented_towards(clip.world_from_camera[:, :3, 3]), points)
            reach = max(self.config.reach, self.config.reach_pixels * pixel_width(clip))
            for frame, mask in enumerate(standing):
                labels[frame][mask] = self._cluster(points[frame][mask], reach)
        return Prediction(labels, background_slot=0)

    def _above(self, plane: Plane, points: Float[np.ndarray, "*point 3"]) -> Bool[np.ndarray, "*point"]:
        height = max(self.config.least_height, self.config.noise_factor * plane.spread)
        return plane.height(points) > height

    def _cluster(self, points: Float[np.ndarray, "point 3"], reach: float) -> Int64[np.ndarray, "point"]:
        """Cluster of each point, counted from 1, and 0 for those that belong to none."""
        if len(points) == 0:
            return np.zeros(0, np.int64)
        ids = cell_ids(points, self.config.voxel)
        _, first, cell, counts = np.unique(ids, return_index=True, return_inverse=True, return_counts=True)
        dbscan = DBSCAN(eps=reach, min_samples=self.config.least_neighbours)
        return dbscan.fit_predict(points[first], sample_weight=counts)[cell] + 1


def world_points(clip: Clip) -> Float[np.ndarray, "frame view height width 3"]:
    """World points of all pixels, metres; meaningless where `clip.valid` is False."""
    cameras = list(zip(clip.k, clip.world_from_camera, strict=True))
    return np.stack([[unproject(d, *camera) for d, camera in zip(f, cameras, strict=True)] for f in clip.depth])


def pixel_width(clip: Clip) -> float:
    """Metres that a pixel spans at the clip's median depth; 0 where nothing is valid."""
    return float(np.median(clip.depth[clip.valid]) / np.mean(clip.k[:, 0, 0])) if np.any(clip.valid) else 0.0


def cell_ids(points: Float[np.ndarray, "point 3"], size: float) -> Int64[np.ndarray, "point"]:
    """One integer for each cubic cell of that many metres; 21 bits an axis hold 8 km of cells of 4 mm."""
    x, y, z = (np.floor(points / size).astype(np.int64) & 0x1FFFFF).T
    return (x << 42) | (y << 21) | z
