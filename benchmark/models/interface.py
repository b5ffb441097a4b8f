"""Interface of models: NumPy in, NumPy out, and no labels as input.

A model is a class with `fit` and `segment`. The benchmark builds it from **options**, passed as keyword arguments: the
values that are tuned for it, and those of the following that are arguments of its constructor. All except `slots` are
passed only if they apply, so they need defaults:

- `slots`: number of slots that a model may use on the track: the track's largest object count, or the value of
  `--slots`, plus one for the background. Models that find the number of objects themselves do not take this option.
- `steps`: number of training steps, in place of a budget in seconds, so that results do not depend on the machine.
- `folder`: folder for files of this run, such as checkpoints. A killed run gets the same folder again and may resume.
  It is passed to models that learn, for the final fit and not during tuning.
- `checkpoint`: folder with trained weights, to be used in place of training (`--pretrained`); `fit` then gets no clips.
- `profile`: `gpu` if images and networks are larger than in the default profile, `cpu`.
- `watch`: a `benchmark.models.validation.ValidationScorer`. A model that learns may call it at intervals as
  `watch(segment, step=, seconds=)`, where `segment` maps a clip to a `Prediction`. Scores on validation clips are then
  added to the run's learning curve.
- `changes`: values of the model's own settings by dotted name, from `ModelSpec.on_tracks`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Integer, UInt8

from benchmark.metrics.poses import Poses as Poses
from datagen.rgbd.clip import Clip as Clip

RECONSTRUCTION_SIDE = 128
"""Longest side of a stored reconstruction, pixels; larger images are subsampled."""
LARGEST_LABEL = 255
"""Largest label; label maps are stored as bytes."""


def object_slots(slots: int) -> int:
    """Number of slots for objects, given a slot count of the benchmark, which includes the background."""
    return slots - 1


def slots_for_objects(objects: int) -> int:
    """Slot count of the benchmark for a number of objects: the inverse of `object_slots`."""
    return objects + 1


@dataclass(frozen=True, eq=False)
class Prediction:
    """Segmentation of a clip."""

    labels: Integer[np.ndarray, "frame view height width"]
    """Slot of every pixel, 0 to `LARGEST_LABEL`, in any order."""
    background_slot: int | None
    """Slot of the background; None if the model has none."""
    extra: Mapping[str, Integer[np.ndarray, "frame view height width"]] = field(default_factory=dict)
    """Further segmentations of the clip with the same background slot, by the names that the model declares
    (`ModelSpec.extra`); each gets its own row, MODEL-NAME."""
    poses: Poses | None = None
    """Poses of the objects in `labels`, if the model has any; they are scored, but do not affect the ranking."""

    @property
    def background(self) -> int:
        """Slot that counts as background: the declared one, otherwise the one with most pixels in the clip."""
        if self.background_slot is not None:
            return self.background_slot
        names, counts = np.unique(self.labels, return_counts=True)
        return int(names[np.argmax(counts)])


@runtime_checkable
class Segmenter(Protocol):
    """A model of the benchmark."""

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Learn from unlabelled clips, for at most `budget` seconds of one core; `seed` determines all randomness."""
        ...

    def segment(self, clip: Clip) -> Prediction:
        """Segment one clip; the result depends on nothing but the clip and the fitted model."""
        ...


@runtime_checkable
class Changeable(Protocol):
    """A model that segments some tracks with other settings than it was fitted with (`ModelSpec.at_test`)."""

    def with_changes(self, changes: Mapping[str, object]) -> Segmenter:
        """Return the fitted model with other values of settings, by dotted name."""
        ...


@runtime_checkable
class Reconstructs(Protocol):
    """A model that can render clips; the report shows a few of its pictures beside its segmentations."""

    def reconstruct_images(
        self, clip: Clip, images: Sequence[tuple[int, int]]
    ) -> UInt8[np.ndarray, "image rows columns 3"] | None:
        """Render these images of a clip, given as frame and view, in the size of the clip or smaller.

        None if the fitted model cannot render.
        """
        ...
