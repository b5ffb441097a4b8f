"""Segments as detections of objects: AP@50, PQ, F1 in single frames; HOTA and IDF1 over time.

Every slot but the background slot that has a pixel in a frame is a detection there, of the identity of its slot.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from benchmark.metrics.overlap import best_pairs

ALPHAS = np.arange(0.05, 0.99, 0.05)
"""Overlaps from which on HOTA counts a pair as a match; it is the mean over them."""
EPSILON = np.finfo(np.float64).eps


def detection_scores(
    overlaps: Float64[np.ndarray, "clip frame object slot"],
    objects: Int64[np.ndarray, "clip frame"],
    segments: Int64[np.ndarray, "clip frame"],
) -> dict[str, Float64[np.ndarray, "clip frame"]]:
    """Scores of each frame from its numbers of objects and segments; nan in frames without objects.

    A match is a pair with an IoU above 0.5; since segments are disjoint, no object or segment is in two such pairs. F1
    is the harmonic mean of precision and recall of the matches. PQ (Kirillov et al., 2019) is F1 times the mean IoU
    of the matches. AP@50 is precision times recall: segments have no confidence, so the curve has one point.
    """
    matched = overlaps > 0.5
    matches = matched.sum(axis=(2, 3))
    overlap = np.where(matched, overlaps, 0.0).sum(axis=(2, 3))
    undefined = np.where(objects > 0, 0.0, np.nan)
    both = np.maximum(objects + segments, 1) / 2
    return {
        "ap50": matches / np.maximum(segments, 1) * (matches / np.maximum(objects, 1)) + undefined,
        "pq": overlap / both + undefined,
        "f1": matches / both + undefined,
    }


def hota(
    overlaps: Float64[np.ndarray, "clip frame object slot"],
    visible: Bool[np.ndarray, "clip frame object"],
    used: Bool[np.ndarray, "clip frame slot"],
) -> Float64[np.ndarray, "clip"]:
    """Higher-order tracking accuracy (Luiten et al., 2021), the mean over `ALPHAS`; nan in clips without objects.

    For each alpha it is the root of DetA times AssA. DetA is the share of matches among matches, missed objects and
    false segments. AssA is the mean over matches of their pair's share of the frames in which one of both is there.
    """
    # Number of frames that show the object, plus of those that show the slot, for each pair.
    either = visible.sum(axis=1)[:, :, None] + used.sum(axis=1)[:, None, :]
    total = visible.sum(axis=(1, 2)) + used.sum(axis=(1, 2))
    # Alignment of each pair over the clip: frames that they may share, by the share of their overlap in each.
    unions = overlaps.sum(axis=2, keepdims=True) + overlaps.sum(axis=3, keepdims=True) - overlaps
    together = np.divide(overlaps, unions, out=np.zeros_like(overlaps), where=unions > EPSILON).sum(axis=1)
    alignment = together / np.maximum(either - together, EPSILON)
    # Pairs of each frame, and matches among them for each alpha.
    paired = np.where(best_pairs(alignment[:, None] * overlaps), overlaps, -1.0)
    matches = np.stack([(paired >= alpha - EPSILON).sum(axis=1) for alpha in ALPHAS])
    found = matches.sum(axis=(2, 3))
    # AssA: the mean over matches of TPA / (TPA + FNA + FPA); HOTA: the root of DetA AssA.
    association = (matches * matches / np.maximum(either - matches, 1)).sum(axis=(2, 3)) / np.maximum(found, 1)
    scores = np.sqrt(association * found / np.maximum(total - found, 1)).mean(axis=0)
    return np.where(visible.any(axis=(1, 2)), scores, np.nan)


def idf1(
    overlaps: Float64[np.ndarray, "clip frame object slot"],
    visible: Bool[np.ndarray, "clip frame object"],
    used: Bool[np.ndarray, "clip frame slot"],
) -> Float64[np.ndarray, "clip"]:
    """F1 of identities (Ristani et al., 2016): each object is matched to one slot for the whole clip.

    A frame counts as correct for such a pair where their IoU is 0.5 or more. nan in clips without objects.
    """
    frames = (overlaps >= 0.5).sum(axis=1)
    correct = np.where(best_pairs(frames), frames, 0).sum(axis=(1, 2))
    total = visible.sum(axis=(1, 2)) + used.sum(axis=(1, 2))
    return np.where(visible.any(axis=(1, 2)), 2 * correct / np.maximum(total, 1), np.nan)
