"""Floors: models that ignore the images; every model must beat their scores."""

import zlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Int64

from benchmark.models.classical.points import Untrained
from benchmark.models.interface import Clip, Prediction


class OneCluster(Untrained):
    """Everything is one object, and nothing is background; implements `Segmenter`."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 1 everywhere; slot 0 of the background stays empty."""
        return Prediction(np.ones(clip.depth.shape, np.int64), background_slot=0)


class AllBackground(Untrained):
    """Everything is background; implements `Segmenter`."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 everywhere."""
        return Prediction(np.zeros(clip.depth.shape, np.int64), background_slot=0)


@dataclass
class RandomSlots(Untrained):
    """Draw the slot of every pixel at random; implements `Segmenter`."""

    slots: int

    def segment(self, clip: Clip) -> Prediction:
        """Draw uniform labels, from the seed and the images, so that they differ between clips."""
        rng = np.random.default_rng([self.seed, zlib.crc32(clip.rgb.tobytes())])
        return Prediction(rng.integers(self.slots, size=clip.depth.shape), background_slot=None)


@dataclass
class ConstantGrid(Untrained):
    """Divide the image into one rectangle of about equal size per slot; implements `Segmenter`."""

    slots: int

    def segment(self, clip: Clip) -> Prediction:
        """Use the same grid in every image."""
        *_, height, width = clip.depth.shape
        grid = grid_cells(height, width, self.slots)
        return Prediction(np.broadcast_to(grid, clip.depth.shape).copy(), background_slot=None)


def grid_cells(height: int, width: int, count: int) -> Int64[np.ndarray, "height width"]:
    """Number `count` cells from 0, in about as many rows as columns; rows differ by at most one cell.

    No cell is empty unless the image is small.
    """
    rows = max(1, round(np.sqrt(count)))
    starts = np.arange(rows + 1) * count // rows
    row = np.arange(height) * rows // height
    cells = starts[row + 1] - starts[row]
    return starts[row][:, None] + np.arange(width) * cells[:, None] // width
