"""Poses without learning: the smallest box around the visible points of a segment.

The hidden side is ignored. This is the baseline for models that infer whole objects.
"""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
import scipy
from jaxtyping import Float, Int64

from benchmark.metrics.box_overlap import Box
from benchmark.metrics.poses import Poses, visible_centers
from benchmark.models.classical.oracles import truth_of
from benchmark.models.classical.plane_hdbscan import PlaneHdbscan
from benchmark.models.classical.points import Untrained
from benchmark.models.interface import Clip, Prediction
from datagen.shapes.geometry.bounding import Outline, minimum_box

LEAST_POINTS = 4
"""Minimum number of points for a rotated box; fewer points only have a centre and extent."""
_THICKNESS = 0.01
"""Radius of the points in the search for the smallest box, relative to the segment's length. Without it, flat segments
would have no volume along any axes."""


@dataclass
class PlaneHdbscanBoxes(PlaneHdbscan):
    """`PlaneHdbscan` with the smallest box around each segment; implements `Segmenter`."""

    def segment(self, clip: Clip) -> Prediction:
        """Segment a clip; each box contains the cluster's points of all views of a frame."""
        found = super().segment(clip)
        return Prediction(
            found.labels, found.background_slot, poses=visible_boxes(found.labels, clip, views="together")
        )


class OracleVisibleBoxes(Untrained):
    """Ground truth, with the smallest box around the visible points of each object."""

    def segment(self, clip: Clip) -> Prediction:
        """Return the ground truth; each view's boxes contain its own points, so that one view suffices to know them."""
        labels = truth_of(clip)
        return Prediction(labels, background_slot=0, poses=visible_boxes(labels, clip, views="apart"))


class OracleVisibleMeans(Untrained):
    """Ground truth, with the mean of the visible points of each object; no orientations, no boxes."""

    def segment(self, clip: Clip) -> Prediction:
        """Return the ground truth, with means per view."""
        labels = truth_of(clip)
        centers = visible_centers(clip.points(), clip.valid, labels, int(labels.max()))
        nowhere = np.full((*centers.shape[:2], 1, 3), np.nan)
        return Prediction(labels, background_slot=0, poses=Poses(np.concatenate([nowhere, centers], axis=2)))


def visible_boxes(
    labels: Int64[np.ndarray, "frame view height width"], clip: Clip, *, views: Literal["together", "apart"]
) -> Poses:
    """Smallest boxes around the points of each label except 0, of all views of a frame together or of each view."""
    points = clip.points()
    frames, count = labels.shape[:2]
    shape = frames, count, int(labels.max()) + 1
    poses = Poses(*(np.full((*shape, *axes), np.nan) for axes in ((3,), (3, 3), (3,))))
    groups = [slice(None)] if views == "together" else [slice(view, view + 1) for view in range(count)]
    for frame, group in product(range(frames), groups):
        for label in range(1, shape[2]):
            mine = (labels[frame, group] == label) & clip.valid[frame, group]
            if mine.any():
                arrays = (poses.center, poses.rotation, poses.size)
                for array, values in zip(arrays, smallest_box(points[frame, group][mine]), strict=True):
                    assert array is not None
                    array[frame, group, label] = values
    return poses


def smallest_box(points: Float[np.ndarray, "point 3"]) -> Box:
    """Centre, rotation and sides of the smallest box around points; axis-aligned if there are too few."""
    try:
        outermost = points[scipy.spatial.ConvexHull(points).vertices]
    except (scipy.spatial.QhullError, ValueError):  # there is no hull, such as in a plane
        outermost = points
    if len(outermost) < LEAST_POINTS:
        return (points.min(axis=0) + points.max(axis=0)) / 2, np.eye(3), np.ptp(points, axis=0)
    radius = _THICKNESS * float(np.ptp(outermost, axis=0).max())
    none, balls = np.zeros((0, 3)), np.full(len(outermost), radius)
    box = minimum_box(Outline(none, outermost, np.zeros((len(outermost), 3, 3)), balls))
    return box.center, box.rotation, np.maximum(box.size - 2 * radius, 0.0)
