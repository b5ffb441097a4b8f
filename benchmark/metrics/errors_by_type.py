"""Types of errors, from contingency tables: an object is merged, split, missed, leaked or renamed.

Also identity over time: whether a model keeps an object in one slot.
"""

import numpy as np
from jaxtyping import Bool, Float64, Int64

from benchmark.metrics.overlap import intersection_over_union

ERROR_TYPES = ("merged", "split", "missed", "leaked", "switched")
"""Names of the types, in the order of the last axis of `errors_by_type`."""

MEANINGS = {
    "merged": "shares its slot with another object",
    "split": "a second slot holds at least a fifth of it",
    "missed": "most of it is in the background slot",
    "leaked": "at least a fifth of its slot lies on the background",
    "switched": "its slot is another one than when it was last seen",
}

PART = 0.2
"""Share of an object, or of a slot, from which on a stray piece counts as an error and not as a ragged edge."""


def errors_by_type(
    tables: Int64[np.ndarray, "frame truth slot"], background_slot: int
) -> Bool[np.ndarray, "frame object type"]:
    """Find the errors of each object in each frame of one view; types as in `ERROR_TYPES`.

    An object's home is the slot that holds most of its pixels. It is

    - missed where its home is the background slot; a missed object is neither merged, split nor leaked,
    - merged where another object has the same home,
    - split where a second slot, not the background's, holds at least `PART` of it,
    - leaked where at least `PART` of its home's pixels are true background,
    - switched where the slot of best IoU differs from that of the last frame in which the object was visible; their
      number is the metric `identity_switches`.

    Row 0 of the tables is the true background; objects that a frame does not show have no errors there.
    """
    objects = tables[:, 1:]
    present = objects.sum(axis=2) > 0
    home = objects.argmax(axis=2)
    missed = present & (home == background_slot)
    housed = present & ~missed
    masks = {
        "merged": housed & _shared(home, housed),
        "split": housed & _second_share(objects, home, background_slot),
        "missed": missed,
        "leaked": housed & np.take_along_axis(_background_share(tables), home, axis=1),
        "switched": switches(intersection_over_union(tables)[:, None])[:, 0],
    }
    return np.stack([masks[name] for name in ERROR_TYPES], axis=-1)


def _shared(home: np.ndarray, housed: np.ndarray) -> Bool[np.ndarray, "frame object"]:
    same = (home[:, :, None] == home[:, None, :]) & housed[:, None, :]
    return same.sum(axis=2) > 1


def _second_share(objects: np.ndarray, home: np.ndarray, background_slot: int) -> Bool[np.ndarray, "frame object"]:
    rest = objects.copy()
    np.put_along_axis(rest, home[:, :, None], 0, axis=2)
    rest[:, :, background_slot] = 0
    return rest.max(axis=2) >= PART * objects.sum(axis=2)


def _background_share(tables: np.ndarray) -> Bool[np.ndarray, "frame slot"]:
    sizes = tables.sum(axis=1)
    return (tables[:, 0] >= PART * sizes) & (sizes > 0)


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
