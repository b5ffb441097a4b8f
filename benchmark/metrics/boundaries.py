"""J&F of DAVIS (Perazzi et al., 2016): overlap and boundary accuracy of objects followed through a clip."""

import math
from itertools import product

import numpy as np
from jaxtyping import Float64, Int64, Integer, UInt8

from benchmark.metrics.overlap import best_pairs, intersection_over_union

TOLERANCE = 0.008
"""Distance at which boundaries still match, as a share of the image's diagonal; rounded up to whole pixels."""

BITS = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1, bitorder="little").astype(np.float64)
GROUP = BITS.shape[1]
"""Number of labels whose boundaries are handled together, as the bits of one byte."""


def region_and_boundary(
    tables: Int64[np.ndarray, "clip frame truth slot"],
    truth: Integer[np.ndarray, "clip frame height width"],
    prediction: Integer[np.ndarray, "clip frame height width"],
    backgrounds: Int64[np.ndarray, "clip"],
) -> Float64[np.ndarray, "clip"]:
    """Mean over objects and frames of J (IoU) and F (F1 of boundary pixels); nan in clips without objects.

    Objects are matched one to one to slots other than the background's, for the whole clip, so that the mean is
    largest. If there are fewer slots, the others are empty. Where object and slot are both absent, J and F are 1
    (rules of DAVIS 2017, unsupervised).
    """
    tables = np.concatenate([tables, np.zeros_like(tables[..., :1])], axis=3)  # the last slot is always empty
    # J of all pairs, and with F their mean over frames.
    visible, used = tables[:, :, 1:].sum(axis=3) > 0, tables.sum(axis=2) > 0
    overlap = intersection_over_union(tables.reshape(-1, *tables.shape[2:]))[:, 1:]
    regions = np.where(visible[..., None] | used[:, :, None], overlap.reshape(*visible.shape, -1), 1.0)
    scores = (regions + boundary_overlap(truth, prediction, *regions.shape[2:])).mean(axis=1) / 2
    # Slots that may be matched; objects that are left over get the empty slot.
    there, candidates = visible.sum(axis=1) > 0, used.sum(axis=1) > 0
    candidates[np.arange(len(tables)), backgrounds] = False
    missing = there.sum(axis=1) - candidates.sum(axis=1)
    empty = np.arange(there.shape[1]) < missing[:, None]
    columns = [scores * candidates[:, None], scores[:, :, -1:] * empty[:, None]]
    scores = np.concatenate(columns, axis=2) * there[:, :, None]
    # The matching with the largest mean.
    total = np.where(best_pairs(scores), scores, 0.0).sum(axis=(1, 2))
    return np.where(there.sum(axis=1) > 0, total / np.maximum(there.sum(axis=1), 1), np.nan)


def boundary_overlap(
    truth: Integer[np.ndarray, "clip frame height width"],
    prediction: Integer[np.ndarray, "clip frame height width"],
    objects: int,
    slots: int,
) -> Float64[np.ndarray, "clip frame object slot"]:
    """F1 of the boundary pixels of every object and slot in each frame; 1 where neither has a boundary.

    A boundary pixel is found if the other boundary is within the tolerance.
    """
    image = truth.shape[2:]
    radius = math.ceil(TOLERANCE * math.hypot(*image))
    true = [_Boundaries(truth.reshape(-1, *image), group, radius) for group in range(objects // GROUP + 1)]
    found = [_Boundaries(prediction.reshape(-1, *image), group, radius) for group in range(-(-slots // GROUP))]
    shape = (truth.shape[0] * truth.shape[1], GROUP * len(true), GROUP * len(found))
    # Boundary pixels of each pair that are near the other boundary, a byte of labels at a time.
    near_true, near_found = np.zeros(shape), np.zeros(shape)
    true_pixels, found_pixels = np.zeros((*shape[:2], 1)), np.zeros((shape[0], 1, shape[2]))
    for (i, one), (j, two) in product(enumerate(true), enumerate(found)):
        rows, columns = (slice(GROUP * index, GROUP * index + GROUP) for index in (i, j))
        near_found[:, rows, columns], true_pixels[:, rows, 0] = one.near(two)
        pairs, found_pixels[:, 0, columns] = two.near(one)
        near_true[:, rows, columns] = pairs.swapaxes(1, 2)
    # F = 2 P R / (P + R).
    precision, recall = near_true / np.maximum(found_pixels, 1), near_found / np.maximum(true_pixels, 1)
    scores = 2 * precision * recall / np.maximum(precision + recall, np.finfo(np.float64).tiny)
    scores = np.where((true_pixels == 0) & (found_pixels == 0), 1.0, scores)
    return scores[:, 1 : objects + 1, :slots].reshape(*truth.shape[:2], objects, slots)


class _Boundaries:
    """Boundary pixels of a group of labels, one bit each, as they are and widened by the tolerance.

    A pixel is a label's boundary if some, but not all, of it and its right, lower and lower right neighbours have the
    label.
    """

    def __init__(self, labels: Integer[np.ndarray, "frame height width"], group: int, radius: int) -> None:
        bits = (labels // GROUP == group) * (np.uint8(1) << (labels % GROUP).astype(np.uint8))
        some, all_ = bits.copy(), bits.copy()
        for here, there in (
            (np.s_[:, :, :-1], np.s_[:, :, 1:]),
            (np.s_[:, :-1], np.s_[:, 1:]),
            (np.s_[:, :-1, :-1], np.s_[:, 1:, 1:]),
        ):
            some[here] |= bits[there]
            all_[here] &= bits[there]
        edges = some & ~all_
        self.widened = _widened(edges, radius).ravel()
        self.places = np.flatnonzero(edges != 0)
        self.bits = edges.ravel()[self.places].astype(np.int64)
        self.frames, self.image = len(labels), labels[0].size

    def near(self, other: "_Boundaries") -> tuple[np.ndarray, np.ndarray]:
        """Count boundary pixels in each frame: of both labels of each pair within tolerance, and of each label."""
        codes = self.bits * len(BITS) + other.widened[self.places]
        known = np.flatnonzero(np.bincount(codes, minlength=1))
        index = np.zeros(len(BITS) ** 2, np.int64)
        index[known] = np.arange(len(known))
        cells = self.places // self.image * len(known) + index[codes]
        counts = np.bincount(cells, minlength=self.frames * len(known)).reshape(self.frames, len(known))
        one, two = BITS[known // len(BITS)], BITS[known % len(BITS)]
        pairs = counts @ (one[:, :, None] * two[:, None]).reshape(len(known), GROUP**2)
        return pairs.reshape(self.frames, GROUP, GROUP), counts @ one


def _widened(bits: UInt8[np.ndarray, "frame height width"], radius: int) -> UInt8[np.ndarray, "frame height width"]:
    """Spread every bit over a disc: rows of growing width are shifted up and down."""
    row, disc = bits.copy(), bits.copy()
    heights = [min(math.isqrt(radius**2 - width**2), bits.shape[1] - 1) for width in range(radius + 1)]
    for width, height in enumerate(heights):
        if width:
            row[:, :, width:] |= bits[:, :, :-width]
            row[:, :, :-width] |= bits[:, :, width:]
        lower = heights[width + 1] if width < radius else -1
        for shift in range(lower + 1, height + 1):
            disc[:, shift:] |= row[:, : bits.shape[1] - shift]
            disc[:, : bits.shape[1] - shift] |= row[:, shift:]
    return disc
