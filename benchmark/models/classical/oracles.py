"""Oracles: models that degrade the ground truth in one known way; they show upper bounds and blind spots of metrics."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from benchmark.models.classical.floors import grid_cells
from benchmark.models.classical.points import Untrained, keep_largest
from benchmark.models.interface import Clip, Prediction, object_slots

QUARTER = 4
"""Side of the blocks of pixels that become one pixel."""
PIECES = 4
"""Number of parts of the background."""


@dataclass
class OracleKSlots(Untrained):
    """Upper bound for K slots: the largest K - 1 objects are right, the others join the background."""

    slots: int

    def segment(self, clip: Clip) -> Prediction:
        """Keep the largest objects of the clip, with constant labels."""
        return Prediction(keep_largest(truth_of(clip), object_slots(self.slots)), background_slot=0)


class OracleQuarterResolution(Untrained):
    """Ground truth at a quarter of the images' resolution, as of a model with coarse masks."""

    def segment(self, clip: Clip) -> Prediction:
        """Give each block of 4x4 pixels its most frequent label; the lowest of equally frequent ones."""
        truth = truth_of(clip)
        return Prediction(coarsen(truth, QUARTER), background_slot=0)


class OracleSplitBackground(Untrained):
    """Ground truth with a background of four quadrants, each a slot; ARI-FG and MSC-FG do not notice."""

    def segment(self, clip: Clip) -> Prediction:
        """Slots 0 to 3 are the quadrants, the first of which is declared as background; objects follow."""
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
    """Count the pixels of the mask in each block."""
    images = mask.reshape(-1, block.size).astype(np.int64)
    order = np.argsort(block.ravel(), kind="stable")
    starts = np.searchsorted(block.ravel()[order], np.arange(blocks))
    return np.add.reduceat(images[:, order], starts, axis=1).reshape(*mask.shape[:-2], blocks)


def truth_of(clip: Clip) -> Int64[np.ndarray, "frame view height width"]:
    """Ground truth of a clip that carries it."""
    if clip.truth is None:
        raise ValueError("An oracle needs clips that carry the truth; register it with uses_labels=True.")
    return clip.truth.astype(np.int64)
