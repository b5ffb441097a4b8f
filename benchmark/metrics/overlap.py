"""Metrics of overlap: how well predicted segments cover objects and background, as intersection over union."""

import math

import numpy as np
import scipy
from jaxtyping import Bool, Float64, Int64, Shaped


def intersection_over_union(tables: Int64[np.ndarray, "frame truth slot"]) -> Float64[np.ndarray, "frame truth slot"]:
    """IoU of every pair of a true and a predicted segment; 0 where both are empty."""
    unions = tables.sum(axis=2)[:, :, None] + tables.sum(axis=1)[:, None, :] - tables
    return tables / np.maximum(unions, 1)


def covering(
    iou: Float64[np.ndarray, "frame truth candidate"], tables: Int64[np.ndarray, "frame truth slot"]
) -> Float64[np.ndarray, "frame"]:
    """Mean over the objects that are there of the best IoU among the slots given; nan in frames without objects.

    The covering of Arbelaez et al. (2011) without weights. Which slots are candidates is for the caller to choose by
    leaving out columns of `iou`; with none left, every object counts 0.
    """
    return _mean_over_objects(iou[:, 1:].max(axis=2, initial=0.0), tables)


def one_to_one_overlap(
    iou: Float64[np.ndarray, "frame truth slot"], tables: Int64[np.ndarray, "frame truth slot"]
) -> Float64[np.ndarray, "frame"]:
    """Mean over the objects of the IoU with the slot matched to each, no slot twice, where that mean is largest.

    All slots may be matched; objects left without one count 0. nan in frames without objects.
    """
    overlaps = iou[:, 1:]
    matched = np.where(best_pairs(overlaps), overlaps, 0.0).sum(axis=2)
    return _mean_over_objects(matched, tables)


def best_pairs(weights: Shaped[np.ndarray, "*batch row column"]) -> Bool[np.ndarray, "*batch row column"]:
    """Pair rows with columns, each at most once, so that the sum of weights is largest; weights are 0 or more."""
    flat = weights.reshape(math.prod(weights.shape[:-2]), *weights.shape[-2:])
    pairs = (np.arange(flat.shape[2]) == flat.argmax(axis=2)[:, :, None]) & (flat > 0)
    # Where no two rows want the same column, nothing can be better.
    for index in np.flatnonzero((pairs.sum(axis=1) > 1).any(axis=1)):
        pairs[index] = False
        pairs[index][scipy.optimize.linear_sum_assignment(flat[index], maximize=True)] = True
    return pairs.reshape(weights.shape)


def background_overlap(
    iou: Float64[np.ndarray, "frame truth slot"], tables: Int64[np.ndarray, "frame truth slot"], slot: int
) -> Float64[np.ndarray, "frame"]:
    """IoU of the true background with the given slot; nan in frames without true background."""
    return np.where(tables[:, 0].sum(axis=1) > 0, iou[:, 0, slot], np.nan)


def oracle_background_overlap(
    iou: Float64[np.ndarray, "frame truth slot"], tables: Int64[np.ndarray, "frame truth slot"]
) -> Float64[np.ndarray, "frame"]:
    """Best IoU of the true background with any slot; nan in frames without true background."""
    return np.where(tables[:, 0].sum(axis=1) > 0, iou[:, 0].max(axis=1), np.nan)


def best_background_slot(
    iou: Float64[np.ndarray, "frame truth slot"], tables: Int64[np.ndarray, "frame truth slot"]
) -> Int64[np.ndarray, "frame"]:
    """Slot that overlaps the true background most, the first of equals; -1 in frames without true background."""
    return np.where(tables[:, 0].sum(axis=1) > 0, iou[:, 0].argmax(axis=1), -1)


def without_slot(
    iou: Float64[np.ndarray, "frame truth slot"], slots: Int64[np.ndarray, "frame"]
) -> Float64[np.ndarray, "frame truth slot"]:
    """Overlaps with one slot of each frame set to 0, so that it is no candidate; -1 leaves a frame unchanged."""
    columns = np.arange(iou.shape[2])
    return np.where(columns == slots[:, None, None], 0.0, iou)


def _mean_over_objects(
    values: Float64[np.ndarray, "frame object"], tables: Int64[np.ndarray, "frame truth slot"]
) -> Float64[np.ndarray, "frame"]:
    present = tables[:, 1:].sum(axis=2) > 0
    objects = present.sum(axis=1)
    return np.where(objects > 0, np.sum(values * present, axis=1) / np.maximum(objects, 1), np.nan)
