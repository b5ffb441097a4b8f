"""What needs no look at the images: scores that every model must beat."""

import zlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from benchmark.models.classical.untrained import Untrained
from benchmark.models.interface import Clip, Prediction


class OneCluster(Untrained):
    """Everything is one object, and nothing is background; implements `Segmenter`."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 1 everywhere; the background's slot 0 stays empty."""
        return Prediction(np.ones(clip.depth.shape, np.int64), background_slot=0)


class AllBackground(Untrained):
    """Everything is background; implements `Segmenter`."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 everywhere."""
        return Prediction(np.zeros(clip.depth.shape, np.int64), background_slot=0)


@dataclass
class RandomSlots(Untrained):
    """Every pixel draws its slot; implements `Segmenter`."""

    slots: int

    def segment(self, clip: Clip) -> Prediction:
        """Uniform labels; the draw follows from the seed and the picture, so that no two clips share it."""
        rng = np.random.default_rng([self.seed, zlib.crc32(clip.rgb.tobytes())])
        return Prediction(rng.integers(self.slots, size=clip.depth.shape), background_slot=None)


@dataclass
class ConstantGrid(Untrained):
    """The picture in rectangles of about equal size, one a slot; implements `Segmenter`."""

    slots: int

    def segment(self, clip: Clip) -> Prediction:
        """The same grid in every image."""
        *_, height, width = clip.depth.shape
        grid = grid_cells(height, width, self.slots)
        return Prediction(np.broadcast_to(grid, clip.depth.shape).copy(), background_slot=None)


def grid_cells(height: int, width: int, count: int) -> Int64[np.ndarray, "height width"]:
    """`count` cells, counted from 0, in as many rows as columns or nearly so; no cell is empty in larger images.

    Rows whose numbers of cells differ, by one at most, where `count` is no product of the two.
    """
    rows = max(1, round(np.sqrt(count)))
    starts = np.arange(rows + 1) * count // rows
    row = np.arange(height) * rows // height
    cells = starts[row + 1] - starts[row]
    return starts[row][:, None] + np.arange(width) * cells[:, None] // width
