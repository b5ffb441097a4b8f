"""Identity over time: whether a model keeps an object in one slot."""

import numpy as np
from jaxtyping import Bool, Float64, Int64


def identity_switches(iou: Float64[np.ndarray, "frame view truth slot"]) -> Int64[np.ndarray, "view"]:
    """Count how often an object's best slot differs from its slot in the last frame in which it was visible."""
    return switches(iou).sum(axis=(0, 2))


def switches(iou: Float64[np.ndarray, "frame view truth slot"]) -> Bool[np.ndarray, "frame view object"]:
    """Find the frames in which an object's best slot differs from its slot in the last frame in which it was visible.

    The best slot is that of the largest IoU, the background's included. Among equals the object stays where it was, or
    could have been: the count is the smallest that any choice among equals gives, so names of slots do not matter.
    """
    best = iou[:, :, 1:].max(axis=3, keepdims=True, initial=0.0)
    choices = (iou[:, :, 1:] == best) & (best > 0)
    switched = np.zeros(choices.shape[:3], bool)
    held = choices[0]
    for frame, now in enumerate(choices):
        kept = held & now
        stays, visible, known = (slots.any(axis=2) for slots in (kept, now, held))
        switched[frame] = visible & known & ~stays
        held = np.where(stays[..., None], kept, np.where(visible[..., None], now, held))
    return switched
