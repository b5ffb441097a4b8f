"""The geometric baseline: take away the largest plane, cluster what stands on it by distance, and perhaps by colour.

It needs no training, and sees every frame by itself, so that its labels keep no identity over time.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64
from sklearn.cluster import DBSCAN

from benchmark.baselines.points import cell_ids, pixel_width, scene_points
from benchmark.baselines.standing import standing
from benchmark.baselines.untrained import Untrained, keep_largest
from benchmark.interface import Clip, Prediction

VOXEL = 0.004
"""Metres; points in one such cell are clustered as one, which bounds the cost of large images and many views."""
LEAST_NEIGHBOURS = 3
"""DBSCAN's min_samples, pixels, the point's own included: objects of a few pixels still make a cluster."""


@dataclass
class PlaneDbscan(Untrained):
    """RANSAC plane removal and DBSCAN on the remaining points; implements `Segmenter`."""

    least_height: float = 0.001
    """Metres above the plane from which on a point belongs to an object; more cuts off the feet of objects."""
    reach: float = 0.02
    """DBSCAN's eps, metres: points closer than this are neighbours; more merges objects, less breaks them up."""
    reach_pixels: float = 3.0
    """In coarse images that reach grows to this many pixels' width on the table, or surfaces would fall apart."""
    colour: float = 0.0
    """Metres that the step from black to full red, green or blue counts as; 0 leaves colour out."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, what lies below it, holes and lone points; clusters count from 1 in every frame."""
        points = scene_points(clip)
        labels = np.zeros(clip.depth.shape, np.int64)
        reach = max(self.reach, self.reach_pixels * pixel_width(clip))
        for frame, mask in enumerate(standing(clip, points, least_height=self.least_height, seed=self.seed)):
            colours = self.colour * (clip.rgb[frame][mask] / 255)
            labels[frame][mask] = keep_largest(cluster(points[frame][mask], colours, reach))
        return Prediction(labels, background_slot=0)


def cluster(
    points: Float[np.ndarray, "point 3"], colours: Float[np.ndarray, "point 3"], reach: float, voxel: float = VOXEL
) -> Int64[np.ndarray, "point"]:
    """Cluster of each point, counted from 1, and 0 for those that belong to none; all in metres, colours too."""
    if len(points) == 0:
        return np.zeros(0, np.int64)
    _, first, cell, counts = np.unique(
        cell_ids(points, voxel), return_index=True, return_inverse=True, return_counts=True
    )
    features = np.hstack([points, colours]) if np.any(colours) else points
    dbscan = DBSCAN(eps=reach, min_samples=LEAST_NEIGHBOURS)
    return dbscan.fit_predict(features[first], sample_weight=counts)[cell] + 1
