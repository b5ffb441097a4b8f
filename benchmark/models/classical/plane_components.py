"""Remove the largest plane, and split the remaining pixels at steps of the depth image."""

from dataclasses import dataclass

import numpy as np
import scipy
from jaxtyping import Bool, Float32, Int64

from benchmark.models.classical.above_plane import standing
from benchmark.models.classical.points import Untrained, keep_largest, pixel_width, scene_points
from benchmark.models.interface import Clip, Prediction

HALF_NEIGHBOURHOOD = ((0, 1), (1, -1), (1, 0), (1, 1))
"""Offsets (row, column) of four of a pixel's eight neighbours; the other four are symmetric. Four neighbours are too
few: 20 % of holes would cut surfaces into pieces."""

LEAST_PIXELS = 3
"""Smaller components are background, as in DBSCAN with its min_samples of 3."""


@dataclass
class PlaneComponents(Untrained):
    """RANSAC plane removal and connected components on the depth image; implements `Segmenter`."""

    step: float = 2.0
    """Depth difference between neighbouring pixels that separates objects, in pixel widths; 1 is a slope of 45
    degrees."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, anything below it, holes and specks; in every image components count from 1."""
        mask = standing(clip, scene_points(clip), seed=self.seed)
        labels, step = np.zeros(clip.depth.shape, np.int64), self.step * pixel_width(clip)
        for image in np.ndindex(*mask.shape[:2]):
            labels[image] = keep_largest(components(clip.depth[image], mask[image], step))
        return Prediction(labels, background_slot=0)


def components(
    depth: Float32[np.ndarray, "height width"], mask: Bool[np.ndarray, "height width"], step: float
) -> Int64[np.ndarray, "height width"]:
    """Connected components of the mask, counted from 1; neighbours are connected if their depths differ by < `step`."""
    index = np.arange(mask.size).reshape(mask.shape)
    edges = [_edges(depth, mask, index, step, *offset) for offset in HALF_NEIGHBOURHOOD]
    here, there = np.hstack(edges)
    graph = scipy.sparse.coo_array((np.ones(len(here), np.int8), (here, there)), (mask.size, mask.size))
    component = scipy.sparse.csgraph.connected_components(graph, directed=False)[1].reshape(mask.shape).astype(np.int64)
    large = np.bincount(component[mask], minlength=mask.size)[component] >= LEAST_PIXELS
    return np.where(mask & large, component + 1, 0)


def _edges(
    depth: np.ndarray, mask: np.ndarray, index: np.ndarray, step: float, down: int, right: int
) -> Int64[np.ndarray, "2 edge"]:
    """Pairs of connected pixels with the given offset."""
    height, width = mask.shape
    here = np.s_[: height - down, max(0, -right) : width - max(0, right)]
    there = np.s_[down:, max(0, right) : width + min(0, right)]
    near = mask[here] & mask[there] & (np.abs(depth[here] - depth[there]) < step)
    return np.stack([index[here][near], index[there][near]])
