"""Scores by object count, visible size, occlusion, contact and frame index."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from benchmark.report.observations import Objects

SIZES = (8, 16, 32, 64, 128, 256, 512, 1024)
"""Least numbers of pixels of the classes of visible size; smaller objects form a class of their own."""

HIDDEN = (0.02, 0.25, 0.5, 0.75)
HIDDEN_NAMES = ("none", "to 25%", "to 50%", "to 75%", "more")

GAPS = (0.0005, 0.005, 0.02)
"""Limits of the contact classes in metres; the dataset format stores no gaps beyond the last."""
GAP_NAMES = ("touching", "to 5 mm", "to 20 mm", "farther")

MOST_FRAMES = 12
"""Largest number of classes over frames; longer clips are divided into this many parts."""


@dataclass(frozen=True, eq=False)
class Slicing:
    """Division of the observations of a track into classes."""

    title: str
    axis: str
    names: tuple[str, ...]
    members: Int64[np.ndarray, "observation"]
    """Class of every observation."""

    @property
    def counts(self) -> Int64[np.ndarray, "name"]:
        """Number of observations in every class."""
        return np.bincount(self.members, minlength=len(self.names))

    def means(self, values: Float64[np.ndarray, "observation"]) -> Float64[np.ndarray, "name"]:
        """Mean of the values in every class; nan in empty ones."""
        sums = np.bincount(self.members, values, minlength=len(self.names))
        return np.where(self.counts > 0, sums / np.maximum(self.counts, 1), np.nan)


@dataclass(frozen=True)
class Missing:
    """Slicing that the dataset does not allow."""

    title: str
    reason: str


def slicings(objects: Objects) -> list[Slicing | Missing]:
    """List the five slicings, in the order in which they are shown."""
    return [
        by_count(objects.companions),
        by_size(objects.pixels),
        _by_classes("Occlusion", "share that is hidden", objects.hidden, HIDDEN, HIDDEN_NAMES),
        _by_classes("Contact", "distance to the nearest object", objects.gap, GAPS, GAP_NAMES),
        by_frame(objects.frame),
    ]


def by_count(companions: Int64[np.ndarray, "observation"]) -> Slicing:
    """Form one class for each number of visible objects that occurs."""
    values, members = np.unique(companions, return_inverse=True)
    return Slicing("Object count", "objects in the image", tuple(map(str, values)), members)


def by_size(pixels: Int64[np.ndarray, "observation"]) -> Slicing:
    """Form classes of doubling size, without empty ones at the ends."""
    members = np.searchsorted(SIZES, pixels, side="right")
    names = (f"<{SIZES[0]}", *(f"{low}+" for low in SIZES))
    first, last = int(members.min(initial=len(SIZES))), int(members.max(initial=0))
    return Slicing("Visible size", "pixels", names[first : last + 1], members - first)


def by_frame(frames: Int64[np.ndarray, "observation"]) -> Slicing | Missing:
    """Form one class for each frame, or for each of `MOST_FRAMES` parts of a long clip."""
    length = int(frames.max(initial=0)) + 1
    if length == 1:
        return Missing("Frame index", "Scenes of this track have one frame.")
    parts = min(length, MOST_FRAMES)
    starts = [-(-part * length // parts) for part in range(parts)]
    return Slicing("Frame index", "frame", tuple(map(str, starts)), frames * parts // length)


def _by_classes(
    title: str, axis: str, values: np.ndarray | None, edges: Sequence[float], names: tuple[str, ...]
) -> Slicing | Missing:
    if values is None:
        return Missing(title, "The dataset has no such field.")
    return Slicing(title, axis, names, np.searchsorted(edges, values, side="right"))
