"""One table of counts per frame, from which all metrics of that frame follow."""

import numpy as np
from jaxtyping import Bool, Int64, Integer

BLOCK = 1 << 20
"""Pixels counted at a time, which bounds the memory that the counting of one huge frame takes."""

LARGEST_DENSE_TABLE = 1 << 16
"""Cells; beyond it labels are renumbered first, so that ids such as 10^9 cost nothing."""


def contingency(
    truth: Integer[np.ndarray, "frame height width"],
    prediction: Integer[np.ndarray, "frame height width"],
    background_slot: int = 0,
    ignore: Bool[np.ndarray, "frame height width"] | None = None,
) -> tuple[Int64[np.ndarray, "frame truth slot"], int]:
    """Pixels that each pair of a true and a predicted label shares, frame by frame, without the ignored ones.

    Row 0 is the true background. The second value is the column of the predicted background slot: labels may have been
    renumbered.

    Raises:
        ValueError: the maps differ in shape, are not integer, hold negative labels outside `ignore`, or are empty, or
            the background slot is negative.
    """
    truth, prediction, background_slot = compact(truth, prediction, background_slot, ignore)
    return count(truth, prediction, background_slot, ignore), background_slot


def compact(
    truth: Integer[np.ndarray, "frame height width"],
    prediction: Integer[np.ndarray, "frame height width"],
    background_slot: int = 0,
    ignore: Bool[np.ndarray, "frame height width"] | None = None,
) -> tuple[Integer[np.ndarray, "frame height width"], Integer[np.ndarray, "frame height width"], int]:
    """Check label maps, make ignored pixels background, and renumber labels if they are too large for a table.

    Arguments and errors as in `contingency`; the last value is the background slot.
    """
    _check(truth, prediction, ignore)
    if background_slot < 0:
        raise ValueError(f"The background slot is {background_slot}; expected 0 or more.")
    if ignore is not None:
        slot = np.array(background_slot, np.min_scalar_type(background_slot))
        truth, prediction = np.where(ignore, 0, truth), np.where(ignore, slot, prediction)
    if truth.min() < 0 or prediction.min() < 0:
        raise ValueError("Labels must not be negative; say with `ignore` which pixels do not count.")
    rows, columns = int(truth.max()) + 1, max(int(prediction.max()), background_slot) + 1
    if rows * columns > LARGEST_DENSE_TABLE:
        truth, _ = _renumber(truth, 0)
        prediction, background_slot = _renumber(prediction, background_slot)
    return truth, prediction, background_slot


def count(
    truth: Integer[np.ndarray, "frame height width"],
    prediction: Integer[np.ndarray, "frame height width"],
    background_slot: int,
    ignore: Bool[np.ndarray, "frame height width"] | None = None,
) -> Int64[np.ndarray, "frame truth slot"]:
    """Count the pixels of `compact` label maps that are not ignored."""
    rows, columns = int(truth.max()) + 1, max(int(prediction.max()), background_slot) + 1
    tables = np.empty((len(truth), rows, columns), np.int64)
    for index in range(len(truth)):
        keep = None if ignore is None else ~ignore[index].ravel()
        tables[index] = _count(truth[index].ravel(), prediction[index].ravel(), keep, rows, columns)
    return tables


def _check(truth: np.ndarray, prediction: np.ndarray, ignore: np.ndarray | None) -> None:
    if truth.ndim != 3 or truth.shape != prediction.shape:
        raise ValueError(
            f"Label maps have shapes {truth.shape} and {prediction.shape}; expected one (frame, height, width)."
        )
    if not (np.issubdtype(truth.dtype, np.integer) and np.issubdtype(prediction.dtype, np.integer)):
        raise ValueError(f"Label maps have dtypes {truth.dtype} and {prediction.dtype}; expected integers.")
    if truth.size == 0:
        raise ValueError(f"Label maps of shape {truth.shape} hold no pixel; expected at least one.")
    if ignore is not None and (ignore.shape != truth.shape or ignore.dtype != bool):
        raise ValueError(f"`ignore` is {ignore.dtype} {ignore.shape}; expected bool {truth.shape}.")


def _renumber(labels: np.ndarray, special: int) -> tuple[np.ndarray, int]:
    """Labels 0, 1, ... in the order of the old ones, and the new number of `special`."""
    names = np.unique(np.append(labels.ravel(), special))
    return np.searchsorted(names, labels), int(np.searchsorted(names, special))


def _count(
    truth: np.ndarray, prediction: np.ndarray, keep: np.ndarray | None, rows: int, columns: int
) -> Int64[np.ndarray, "truth slot"]:
    cells = np.zeros(rows * columns, np.int64)
    for start in range(0, len(truth), BLOCK):
        part = slice(start, start + BLOCK)
        index = truth[part].astype(np.int64) * columns + prediction[part].astype(np.int64)
        cells += np.bincount(index if keep is None else index[keep[part]], minlength=rows * columns)
    return cells.reshape(rows, columns)
