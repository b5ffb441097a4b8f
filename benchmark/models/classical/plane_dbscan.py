"""The geometric baseline: remove the largest plane, and cluster the remaining points by distance, and maybe colour."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64, UInt8
from sklearn.cluster import DBSCAN

from benchmark.models.classical.above_plane import PlaneClustering
from benchmark.models.classical.points import VOXEL_PIXELS, voxels

LEAST_NEIGHBOURS = 3
"""DBSCAN's min_samples in pixels, the point's own included; objects of a few pixels still make a cluster."""


@dataclass
class PlaneDbscan(PlaneClustering):
    """RANSAC plane removal and DBSCAN on the remaining points; implements `Segmenter`."""

    reach: float = 2.0
    """DBSCAN's eps in pixel widths; larger values merge objects, smaller ones split them."""
    colour: float = 0.0
    """Weight of colour: distance from black to full red, green or blue, in units of `reach`; 0 ignores colour."""

    def cluster(
        self, points: Float[np.ndarray, "point 3"], rgb: UInt8[np.ndarray, "point 3"], pixel: float
    ) -> Int64[np.ndarray, "point"]:
        """Cluster the points, one per voxel and weighted by the points in it."""
        reach = self.reach * pixel
        features = np.hstack([points, self.colour * reach / 255 * rgb]) if self.colour else points
        first, cell, counts = voxels(points, VOXEL_PIXELS * pixel)
        dbscan = DBSCAN(eps=reach, min_samples=LEAST_NEIGHBOURS)
        return dbscan.fit_predict(features[first], sample_weight=counts)[cell] + 1
