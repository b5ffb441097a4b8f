"""Models that see the truth and spoil it in one known way: how far a score can go, and to what a metric is blind."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64, UInt8

from benchmark.models.classical.floors import grid_cells
from benchmark.models.classical.untrained import Untrained, keep_largest
from benchmark.models.interface import Clip, Prediction

QUARTER = 4
"""Pixels a side that become one."""
PIECES = 4
"""Parts into which the background falls."""

Truth = UInt8[np.ndarray, "frame view height width"]


@dataclass
class OracleKSlots(Untrained):
    """The best that K slots can do: K - 1 objects are right, the smallest join the background."""

    slots: int

    def segment(self, clip: Clip) -> Prediction:
        """Objects are counted over the clip, and keep their labels in it."""
        return Prediction(keep_largest(truth_of(clip), self.slots - 1), background_slot=0)


class OracleQuarterResolution(Untrained):
    """The truth as seen by a model whose masks have a quarter of the images' resolution."""

    def segment(self, clip: Clip) -> Prediction:
        """In each block of 4x4 pixels the most frequent label, the lowest of equally frequent ones."""
        truth = truth_of(clip)
        return Prediction(coarsen(truth, QUARTER), background_slot=0)


class OracleSplitBackground(Untrained):
    """The truth, but that the background falls into four quadrants, each a slot: ARI-FG and MSC-FG do not see it."""

    def segment(self, clip: Clip) -> Prediction:
        """Slots 0 to 3 are the quadrants, the first of them declared as background; objects follow."""
        truth = truth_of(clip)
        *_, height, width = truth.shape
        quadrants = grid_cells(height, width, PIECES)
        return Prediction(np.where(truth > 0, truth + PIECES - 1, quadrants), background_slot=0)


def coarsen(labels: Int64[np.ndarray, "*image height width"], factor: int) -> Int64[np.ndarray, "*image height width"]:
    """Majority label of each square block; blocks at the right and lower border may be smaller."""
    *_, height, width = labels.shape
    rows, columns = -(-height // factor), -(-width // factor)
    block = (np.arange(height) // factor)[:, None] * columns + np.arange(width) // factor
    votes = np.stack([_votes(labels == name, block, rows * columns) for name in range(labels.max() + 1)])
    return np.argmax(votes, axis=0)[..., block]


def _votes(mask: np.ndarray, block: np.ndarray, blocks: int) -> np.ndarray:
    """How many pixels of the mask each block holds."""
    images = mask.reshape(-1, block.size).astype(np.int64)
    order = np.argsort(block.ravel(), kind="stable")
    starts = np.searchsorted(block.ravel()[order], np.arange(blocks))
    return np.add.reduceat(images[:, order], starts, axis=1).reshape(*mask.shape[:-2], blocks)


def truth_of(clip: Clip) -> Int64[np.ndarray, "frame view height width"]:
    """Labels of a clip that carries them."""
    if clip.truth is None:
        raise ValueError("An oracle needs clips that carry the truth; register it with uses_labels=True.")
    return clip.truth.astype(np.int64)
