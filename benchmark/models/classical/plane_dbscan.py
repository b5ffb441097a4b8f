"""The geometric baseline: remove the largest plane, and cluster the remaining points by distance, and maybe colour."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Float, Int64, UInt8

from benchmark.models.classical.above_plane import PlaneClustering
from benchmark.models.classical.points import VOXEL_PIXELS, keep_largest, scene_points, voxels
from benchmark.models.interface import Clip, Prediction

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
        from sklearn.cluster import DBSCAN  # late: scikit-learn takes a second to import

        reach = self.reach * pixel
        features = np.hstack([points, self.colour * reach / 255 * rgb]) if self.colour else points
        first, cell, counts = voxels(points, VOXEL_PIXELS * pixel)
        dbscan = DBSCAN(eps=reach, min_samples=LEAST_NEIGHBOURS)
        return dbscan.fit_predict(features[first], sample_weight=counts)[cell] + 1


LARGEST_MOVE = 0.15
"""Metres that a centroid may move in a frame. The fastest thrown objects, 1.1 m/s, move 0.09 m at 12 frames/s; the rest
is for parts that appear or become hidden. It is not tuned, as scores of single frames do not depend on identity."""


@dataclass
class PlaneDbscanTracked(PlaneDbscan):
    """Plane removal and DBSCAN, with clusters tracked over frames; implements `Segmenter`."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is as in `PlaneDbscan`; other labels denote one object in the whole clip."""
        labels = super().segment(clip).labels
        return Prediction(keep_largest(follow(labels, scene_points(clip))), background_slot=0)


def follow(
    labels: Int64[np.ndarray, "frame view height width"], points: Float[np.ndarray, "frame view height width 3"]
) -> Int64[np.ndarray, "frame view height width"]:
    """Relabel clusters: each gets the label of the nearest earlier object, one to one, or a new label.

    A hidden object keeps its last centroid, and gets its label back if it reappears there.
    """
    tracks = np.zeros((0, 3))
    followed = np.zeros_like(labels)
    for frame, (image, where) in enumerate(zip(labels, points, strict=True)):
        centroids = _centroids(image, where)
        ids, tracks = _match(tracks, centroids)
        followed[frame] = np.append(0, ids + 1)[image]
    return followed


def _centroids(
    labels: Int64[np.ndarray, "view height width"], points: Float[np.ndarray, "view height width 3"]
) -> Float[np.ndarray, "cluster 3"]:
    """Mean points of the clusters 1, 2, ..., none of which is empty."""
    inside = labels > 0
    counts = np.bincount(labels[inside])[1:]
    sums = [np.bincount(labels[inside], axis)[1:] for axis in points[inside].T]
    return np.stack(sums, axis=-1) / counts[:, None]


def _match(
    tracks: Float[np.ndarray, "track 3"], centroids: Float[np.ndarray, "cluster 3"]
) -> tuple[Int64[np.ndarray, "cluster"], Float[np.ndarray, "track_or_new 3"]]:
    """Assign clusters to tracks; also returns the last centroids of all tracks, new ones at the end."""
    distances = np.minimum(scipy.spatial.distance.cdist(centroids, tracks), LARGEST_MOVE)
    clusters, known = scipy.optimize.linear_sum_assignment(distances)
    near = distances[clusters, known] < LARGEST_MOVE
    ids = np.full(len(centroids), -1)
    ids[clusters[near]] = known[near]
    new = ids < 0
    ids[new] = len(tracks) + np.arange(np.count_nonzero(new))
    tracks = np.concatenate([tracks, centroids[new]])
    tracks[ids] = centroids
    return ids, tracks
