"""`plane_dbscan` with identity: clusters of successive frames are one object where their centroids are near."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int64
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from benchmark.models.classical.plane_dbscan import PlaneDbscan
from benchmark.models.classical.points import scene_points
from benchmark.models.classical.untrained import keep_largest
from benchmark.models.interface import Clip, Prediction

LARGEST_MOVE = 0.15
"""Metres that a centroid may move in a frame: 1.1 m/s, the fastest that recipes throw, is 0.09 m at 12 frames/s; the
rest is for parts that appear and hide. Scores of single frames cannot tell tracks apart, so it is not tuned."""


@dataclass
class PlaneDbscanTracked(PlaneDbscan):
    """Plane removal and DBSCAN, followed over frames; implements `Segmenter`."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is as in `PlaneDbscan`; another label is one object in the whole clip."""
        labels = super().segment(clip).labels
        return Prediction(keep_largest(follow(labels, scene_points(clip))), background_slot=0)


def follow(
    labels: Int64[np.ndarray, "frame view height width"], points: Float[np.ndarray, "frame view height width 3"]
) -> Int64[np.ndarray, "frame view height width"]:
    """New labels: a cluster takes that of the nearest object seen so far, one to one, or else a new one.

    An object that hides keeps its last centroid, and takes its label up again where it comes back.
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
    """Mean point of the clusters 1, 2, ..., none of them empty."""
    inside = labels > 0
    counts = np.bincount(labels[inside])[1:]
    sums = [np.bincount(labels[inside], axis)[1:] for axis in points[inside].T]
    return np.stack(sums, axis=-1) / counts[:, None]


def _match(
    tracks: Float[np.ndarray, "track 3"], centroids: Float[np.ndarray, "cluster 3"]
) -> tuple[Int64[np.ndarray, "cluster"], Float[np.ndarray, "track_or_new 3"]]:
    """The track of each cluster, and all tracks where they were seen last, new ones at the end."""
    distances = np.minimum(cdist(centroids, tracks), LARGEST_MOVE)
    clusters, known = linear_sum_assignment(distances)
    near = distances[clusters, known] < LARGEST_MOVE
    ids = np.full(len(centroids), -1)
    ids[clusters[near]] = known[near]
    new = ids < 0
    ids[new] = len(tracks) + np.arange(np.count_nonzero(new))
    tracks = np.concatenate([tracks, centroids[new]])
    tracks[ids] = centroids
    return ids, tracks
