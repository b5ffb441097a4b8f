"""Divide what stands on the table where surfaces meet in a concave edge, change colour, or are apart.

Neighbouring pixels attract or repel each other (the convexity criterion of Stein et al. 2014, with colour and gaps
added); average linkage joins the pairs of segments with the largest mean attraction as long as it is positive (Bailoni
et al. 2022).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64, UInt8

from benchmark.models.classical.above_plane import standing
from benchmark.models.classical.plane_hdbscan import adopt_lone
from benchmark.models.classical.points import Untrained, keep_largest, pixel_width, scene_points
from benchmark.models.interface import Clip, Prediction
from obpose.contact.linkage import average_linkage

OFFSETS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns from a pixel to those that it is compared with."""
GAP_WEIGHT = 60.0
"""Repulsion per metre beyond `Convexity.gap`."""
LEAST_PIXELS = 6
"""Smaller segments join the nearest larger one, or are background."""
ADOPTION = 4.0
"""Smaller segments join others within this many times the gap."""
DARK = 0.05
"""Value added to the brightness that colours are divided by: dark pixels have no reliable hue."""

Image3 = Float[np.ndarray, "height width 3"]


@dataclass
class Convexity(Untrained):
    """RANSAC plane removal, then signed edges and average linkage in every image; implements `Segmenter`."""

    concavity: float = 2.0
    """Repulsion per unit of concavity, the sine of the angle by which two surfaces bend towards each other."""
    colour: float = 2.0
    """Repulsion per unit of difference in chromaticity."""
    gap: float = 1.75
    """Distance in pixels' width from which points repel each other."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, points below it, holes and specks; segments count from 1 in every image."""
        points, gap = scene_points(clip), self.gap * pixel_width(clip)
        mask = standing(clip, points, seed=self.seed)
        labels = np.zeros(clip.depth.shape, np.int64)
        for image in np.ndindex(*mask.shape[:2]):
            labels[image] = keep_largest(
                self._divide(points[image], clip.rgb[image], clip.valid[image], mask[image], gap)
            )
        return Prediction(labels, background_slot=0)

    def _divide(
        self,
        points: Image3,
        rgb: UInt8[np.ndarray, "height width 3"],
        valid: Bool[np.ndarray, "height width"],
        mask: Bool[np.ndarray, "height width"],
        gap: float,
    ) -> Int64[np.ndarray, "height width"]:
        """Segments of one image, from 1; 0 outside the mask. `gap` is in metres."""
        normal, brightness = normals(points, valid), rgb.sum(axis=-1, keepdims=True) / 255 + DARK
        chromaticity = rgb / 255 / brightness
        index = np.full(mask.shape, -1)
        index[mask] = np.arange(np.count_nonzero(mask))
        pairs, attractions = [], []
        for here, there in _pairs(index):
            between = points[there] - points[here]
            distance = np.linalg.norm(between, axis=-1) + 1e-6
            # Positive where surfaces bend away from each other, as on one convex body.
            convexity = ((normal[there] - normal[here]) * between).sum(axis=-1) / distance
            difference = np.linalg.norm(chromaticity[there] - chromaticity[here], axis=-1)
            attractions.append(
                1
                - self.concavity * np.maximum(-convexity, 0)
                - self.colour * difference
                - GAP_WEIGHT * np.maximum(distance - gap, 0)
            )
            pairs.append(np.stack([index[here], index[there]]))
        segments = average_linkage(int(np.count_nonzero(mask)), np.hstack(pairs), np.hstack(attractions))
        large = np.where(np.bincount(segments, minlength=1)[segments] >= LEAST_PIXELS, segments + 1, 0)
        labels = np.zeros(mask.shape, np.int64)
        labels[mask] = adopt_lone(points[mask], large, ADOPTION * gap)
        return labels


def _pairs(index: Int64[np.ndarray, "height width"]) -> Iterator[tuple[tuple, tuple]]:
    """Rows and columns of pairs of pixels that both have an index, for each offset."""
    height, width = index.shape
    rows, columns = np.nonzero(index >= 0)
    for down, right in OFFSETS:
        below, beside = rows + down, columns + right
        inside = (below < height) & (beside >= 0) & (beside < width)
        inside[inside] = index[below[inside], beside[inside]] >= 0
        yield (rows[inside], columns[inside]), (below[inside], beside[inside])


def normals(points: Image3, valid: Bool[np.ndarray, "height width"]) -> Image3:
    """Unit normals from differences to the nearer neighbour along each axis of the image; 0 where there are none."""
    down, right = (_difference(points, valid, axis) for axis in (0, 1))
    normal = np.cross(down, right)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)


def _difference(points: Image3, valid: Bool[np.ndarray, "height width"], axis: int) -> Image3:
    """Difference between neighbours along an axis, on the side where it is smaller; 0 if neither side is valid."""
    points, valid = np.moveaxis(points, axis, 0), np.moveaxis(valid, axis, 0)
    step = np.diff(points, axis=0)
    step[~(valid[1:] & valid[:-1])] = np.inf
    none = np.full_like(points[:1], np.inf)
    after, before = np.concatenate([step, none]), np.concatenate([none, step])
    nearer = np.where((np.abs(after).max(-1) < np.abs(before).max(-1))[..., None], after, before)
    return np.moveaxis(np.where(np.isfinite(nearer), nearer, 0.0), 0, axis)
