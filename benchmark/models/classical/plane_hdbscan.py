"""Plane removal and HDBSCAN (Campello et al., 2013), which needs no common distance for all objects."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float, Int64, UInt8

from benchmark.models.classical.above_plane import PlaneClustering
from benchmark.models.classical.points import VOXEL_PIXELS, voxels

LEAST_NEIGHBOURS = 3
"""HDBSCAN's min_samples, cells."""
ADOPTION_PIXELS = 4.0
"""Distance in pixel widths within which a noise point joins a cluster; specks of the table are farther away."""


@dataclass
class PlaneHdbscan(PlaneClustering):
    """RANSAC plane removal and HDBSCAN on the remaining points; implements `Segmenter`."""

    least_cells: int = 4
    """HDBSCAN's min_cluster_size; smaller groups are not objects."""

    def cluster(
        self, points: Float[np.ndarray, "point 3"], rgb: UInt8[np.ndarray, "point 3"], pixel: float
    ) -> Int64[np.ndarray, "point"]:
        """Cluster the points, one per voxel, and add nearby lone points to clusters."""
        first, cell, _ = voxels(points, VOXEL_PIXELS * pixel)
        if len(first) < max(self.least_cells, LEAST_NEIGHBOURS):
            return np.zeros(len(points), np.int64)
        clusters = self._hdbscan(points[first], one_cluster=False)
        if not np.any(clusters):
            # HDBSCAN prefers splits, and may call everything noise where there is nothing to split.
            clusters = self._hdbscan(points[first], one_cluster=True)
        return adopt_lone(points[first], clusters, ADOPTION_PIXELS * pixel)[cell]

    def _hdbscan(self, points: Float[np.ndarray, "point 3"], *, one_cluster: bool) -> Int64[np.ndarray, "point"]:
        from sklearn.cluster import HDBSCAN  # late: scikit-learn takes a second to import

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
    """Add points without a cluster (label 0) to the cluster of the nearest point within `distance` metres."""
    lone = labels == 0
    if np.all(lone):
        return labels
    # Beyond the distance the query returns the number of points, where the label is 0.
    nearest = scipy.spatial.KDTree(points[~lone]).query(points[lone], distance_upper_bound=distance)[1]
    adopted = labels.copy()
    adopted[lone] = np.append(labels[~lone], 0)[nearest]
    return adopted
