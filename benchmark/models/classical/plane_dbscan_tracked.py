"""`plane_dbscan` with identity over time: clusters of successive frames with near centroids are one object."""

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
