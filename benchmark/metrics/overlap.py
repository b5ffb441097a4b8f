"""Metrics of overlap: how well predicted segments cover objects and background, as intersection over union."""

import numpy as np
from jaxtyping import Float64, Int64


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
    present = tables[:, 1:].sum(axis=2) > 0
    best = iou[:, 1:].max(axis=2, initial=0.0)
    objects = present.sum(axis=1)
    return np.where(objects > 0, np.sum(best * present, axis=1) / np.maximum(objects, 1), np.nan)


def background_overlap(
    iou: Float64[np.ndarray, "frame truth slot"], tables: Int64[np.ndarray, "frame truth slot"], slot: int
) -> Float64[np.ndarray, "frame"]:
    """IoU of the true background with the given slot; nan in frames without true background."""
    return np.where(tables[:, 0].sum(axis=1) > 0, iou[:, 0, slot], np.nan)
