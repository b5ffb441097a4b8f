"""As `plane_dbscan`, with HDBSCAN (Campello et al., 2013), which needs no one distance that suits all objects."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64
from scipy.spatial import KDTree
from sklearn.cluster import HDBSCAN

from benchmark.models.classical.above_plane import standing
from benchmark.models.classical.points import VOXEL_PIXELS, pixel_width, scene_points, voxels
from benchmark.models.classical.untrained import Untrained, keep_largest
from benchmark.models.interface import Clip, Prediction

LEAST_NEIGHBOURS = 3
"""HDBSCAN's min_samples, cells."""
ADOPTION_PIXELS = 4.0
"""Pixels' width within which a point that HDBSCAN takes for noise joins a cluster; specks of the table lie farther."""


@dataclass
class PlaneHdbscan(Untrained):
    """RANSAC plane removal and HDBSCAN on the remaining points; implements `Segmenter`."""

    least_cells: int = 4
    """HDBSCAN's min_cluster_size: groups of fewer points are no object."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, what lies below it, holes and lone points; clusters count from 1 in every frame."""
        points, pixel = scene_points(clip), pixel_width(clip)
        labels = np.zeros(clip.depth.shape, np.int64)
        for frame, mask in enumerate(standing(clip, points, seed=self.seed)):
            labels[frame][mask] = keep_largest(self._cluster(points[frame][mask], pixel))
        return Prediction(labels, background_slot=0)

    def _cluster(self, points: Float[np.ndarray, "point 3"], pixel: float) -> Int64[np.ndarray, "point"]:
        """Cluster of each point, counted from 1, and 0 for those that belong to none; `pixel` is in metres."""
        if len(points) == 0:
            return np.zeros(0, np.int64)
        first, cell, _ = voxels(points, VOXEL_PIXELS * pixel)
        if len(first) < max(self.least_cells, LEAST_NEIGHBOURS):
            return np.zeros(len(points), np.int64)
        clusters = self._hdbscan(points[first], one_cluster=False)
        if not np.any(clusters):
            # HDBSCAN prefers splits, and may call everything noise where there is nothing to split.
            clusters = self._hdbscan(points[first], one_cluster=True)
        return adopt_lone(points[first], clusters, ADOPTION_PIXELS * pixel)[cell]

    def _hdbscan(self, points: Float[np.ndarray, "point 3"], *, one_cluster: bool) -> Int64[np.ndarray, "point"]:
        hdbscan = HDBSCAN(
            min_cluster_size=self.least_cells,
            min_samples=LEAST_NEIGHBOURS,
            allow_single_cluster=one_cluster,
            copy=True,  # pyright: ignore[reportArgumentType]
        )
        return hdbscan.fit_predict(points) + 1


def adopt_lone(
    points: Float[np.ndarray, "point 3"], labels: Int64[np.ndarray, "point"], distance: float
) -> Int64[np.ndarray, "point"]:
    """Points in no cluster, label 0, join that of the nearest point in one, if that is within `distance` metres."""
    lone = labels == 0
    if np.all(lone):
        return labels
    # Beyond the distance the query gives the number of points, where the label is 0.
    nearest = KDTree(points[~lone]).query(points[lone], distance_upper_bound=distance)[1]
    adopted = labels.copy()
    adopted[lone] = np.append(labels[~lone], 0)[nearest]
    return adopted
