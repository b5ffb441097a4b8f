"""What a model gets and what it gives back: NumPy in, NumPy out, and no label on the way in.

A model is a class with `fit` and `segment`. The benchmark builds it from **options**, given as keyword arguments: the
values that are tuned for it, by name, and those of the following for which its constructor has an argument:

- `slots`: how many slots every model may use on the track, which is its largest object count or what `--slots` says,
  plus one for the background. Models that find the number of objects themselves do not take it, and may use more.
- `steps`: how many steps of training to make, whatever time they take. It is given only where results must not depend
  on the speed of the machine, and so it needs a default.
- `folder`: where to keep files of this run, such as checkpoints. A run that was killed gets the same folder when it is
  made again, and may go on from what it left there. It is given to models that learn, for the fit that counts and not
  while values are tuned, and so it needs a default.
- `checkpoint`: a folder with the weights of a model that was trained before, to be used in the place of training
  (`--pretrained`); `fit` then gets no clips. It needs a default too.
- `profile`: `gpu` where images and networks are larger than in the default, which is `cpu`.
- `watch`: a `benchmark.execution.validation_scores.Watch`. A model that learns calls it now and then as
  `watch(segment, step=, seconds=)`, where `segment` maps a clip to a `Prediction`. Scores on validation clips are then
  added to the run's learning curve. It needs a default too.
- `changes`: values of the model's own settings by dotted name, which `ModelSpec.on_tracks` gives. It needs a default.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32, Integer, UInt8

LARGEST_LABEL = 255
"""Label maps are kept as bytes."""


@dataclass(frozen=True, eq=False)
class Clip:
    """What cameras that stand still saw of one scene. Frames of reference as in `datagen.geometry`."""

    rgb: UInt8[np.ndarray, "frame view height width 3"]
    """sRGB."""
    depth: Float32[np.ndarray, "frame view height width"]
    """Planar z in metres, 0 where there is no return."""
    valid: Bool[np.ndarray, "frame view height width"]
    """Whether the pixel has a depth."""
    k: Float[np.ndarray, "view 3 3"]
    """Camera matrices in pixels, pixel centres at +0.5."""
    world_from_camera: Float[np.ndarray, "view 4 4"]
    """Poses of the cameras, metres."""
    truth: UInt8[np.ndarray, "frame view height width"] | None = None
    """Object ids, 0 = background; None for every model but those registered with `uses_labels`."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Where the objects are and how they are turned, one row a label: row 3 is of what has label 3 in that image.

    World frame, metres. Rows of labels that have no pose, such as the background's, are nan.
    """

    center: Float[np.ndarray, "frame view label 3"]
    """Middle of the whole object, and of its box: not of its visible side alone."""
    rotation: Float[np.ndarray, "frame view label 3 3"] | None = None
    """World from box; None if the model says nothing of orientations. How the box's axes are named does not matter."""
    size: Float[np.ndarray, "frame view label 3"] | None = None
    """Side lengths of the box along its axes; None if the model says nothing of sizes. It needs `rotation`."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """One segmentation of a clip."""

    labels: Integer[np.ndarray, "frame view height width"]
    """Slot of every pixel, 0 to `LARGEST_LABEL`; which slot stands for which object is the model's affair."""
    background_slot: int | None
    """The slot that the model means as background; None if it means none."""
    extra: Mapping[str, Integer[np.ndarray, "frame view height width"]] = field(default_factory=dict)
    """Other segmentations of the clip that came of the same work, with the same background slot, by the names that the
    model declares (`ModelSpec.extra`); each gets a row of its own, MODEL-NAME."""
    poses: Poses | None = None
    """Of the objects behind `labels`, if the model has such; they are scored beside the labels and rank nothing."""

    @property
    def background(self) -> int:
        """The slot that counts as background: the declared one, or else the one with most pixels in the clip."""
        if self.background_slot is not None:
            return self.background_slot
        names, counts = np.unique(self.labels, return_counts=True)
        return int(names[np.argmax(counts)])


@runtime_checkable
class Segmenter(Protocol):
    """A model under test."""

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Learn from unlabelled clips, for at most `budget` seconds of one core; all randomness comes from `seed`."""
        ...

    def segment(self, clip: Clip) -> Prediction:
        """Segment one clip; equal clips get equal predictions, whatever was segmented before."""
        ...
