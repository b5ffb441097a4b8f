"""The geometric baseline: take away the largest plane, cluster what stands on it by distance, and perhaps by colour.

It needs no training, and sees every frame by itself, so that its labels keep no identity over time.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64, UInt8
from sklearn.cluster import DBSCAN

from benchmark.models.classical.above_plane import standing
from benchmark.models.classical.points import VOXEL_PIXELS, pixel_width, scene_points, voxels
from benchmark.models.classical.untrained import Untrained, keep_largest
from benchmark.models.interface import Clip, Prediction

LEAST_NEIGHBOURS = 3
"""DBSCAN's min_samples, pixels, the point's own included: objects of a few pixels still make a cluster."""


@dataclass
class PlaneDbscan(Untrained):
    """RANSAC plane removal and DBSCAN on the remaining points; implements `Segmenter`."""

    reach: float = 2.0
    """DBSCAN's eps: points so many pixels' width apart are neighbours; more merges objects, less splits them."""
    colour: float = 0.0
    """How many of these reaches the step from black to full red, green or blue counts as; 0 leaves colour out."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, what lies below it, holes and lone points; clusters count from 1 in every frame."""
        points, pixel = scene_points(clip), pixel_width(clip)
        labels = np.zeros(clip.depth.shape, np.int64)
        for frame, mask in enumerate(standing(clip, points, seed=self.seed)):
            labels[frame][mask] = keep_largest(self._cluster(points[frame][mask], clip.rgb[frame][mask], pixel))
        return Prediction(labels, background_slot=0)

    def _cluster(
        self, points: Float[np.ndarray, "point 3"], rgb: UInt8[np.ndarray, "point 3"], pixel: float
    ) -> Int64[np.ndarray, "point"]:
        """Cluster of each point, counted from 1, and 0 for those that belong to none; `pixel` is in metres."""
        if len(points) == 0:
            return np.zeros(0, np.int64)
        reach = self.reach * pixel
        features = np.hstack([points, self.colour * reach / 255 * rgb]) if self.colour else points
        first, cell, counts = voxels(points, VOXEL_PIXELS * pixel)
        dbscan = DBSCAN(eps=reach, min_samples=LEAST_NEIGHBOURS)
        return dbscan.fit_predict(features[first], sample_weight=counts)[cell] + 1
