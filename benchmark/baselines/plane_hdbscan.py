"""As `plane_dbscan`, with HDBSCAN (Campello et al., 2013), which needs no one distance that suits all objects."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64
from scipy.spatial import KDTree
from sklearn.cluster import HDBSCAN

from benchmark.baselines.points import VOXEL_PIXELS, pixel_width, scene_points, voxels
from benchmark.baselines.standing import standing
from benchmark.baselines.untrained import Untrained, keep_largest
from benchmark.interface import Clip, Prediction

LEAST_NEIGHBOURS = 3
"""HDBSCAN's min_samples, cells."""


@dataclass
class PlaneHdbscan(Untrained):
    """RANSAC plane removal and HDBSCAN on the remaining points; implements `Segmenter`."""

    least_cells: int = 5
    """HDBSCAN's min_cluster_size: groups of fewer points are no object."""
    one_object: bool = False
    """HDBSCAN's allow_single_cluster: whether all points may be one object; if not, a lone object falls apart."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, what lies below it and holes; clusters count from 1 in every frame."""
        points, voxel = scene_points(clip), VOXEL_PIXELS * pixel_width(clip)
        labels = np.zeros(clip.depth.shape, np.int64)
        for frame, mask in enumerate(standing(clip, points, seed=self.seed)):
            labels[frame][mask] = keep_largest(self._cluster(points[frame][mask], voxel))
        return Prediction(labels, background_slot=0)

    def _cluster(self, points: Float[np.ndarray, "point 3"], voxel: float) -> Int64[np.ndarray, "point"]:
        """Cluster of each point, counted from 1; 0 for all where there are too few for one cluster."""
        if len(points) == 0:
            return np.zeros(0, np.int64)
        first, cell, _ = voxels(points, voxel)
        if len(first) < max(self.least_cells, LEAST_NEIGHBOURS):
            return np.zeros(len(points), np.int64)
        hdbscan = HDBSCAN(
            min_cluster_size=self.least_cells,
            min_samples=LEAST_NEIGHBOURS,
            allow_single_cluster=self.one_object,
            copy=True,  # pyright: ignore[reportArgumentType]
        )
        return _adopt_lone(points[first], hdbscan.fit_predict(points[first]) + 1)[cell]


def _adopt_lone(points: Float[np.ndarray, "point 3"], labels: Int64[np.ndarray, "point"]) -> Int64[np.ndarray, "point"]:
    """Points in no cluster, label 0, join the nearest one: the plane is gone, so that they are parts of objects."""
    lone = labels == 0
    if np.any(lone) and not np.all(lone):
        nearest = KDTree(points[~lone]).query(points[lone])[1]
        labels[lone] = labels[~lone][nearest]
    return labels
