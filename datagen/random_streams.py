"""Random generators of a dataset, one per purpose; each is a function of `(seed, split, index, stream)` alone."""

from typing import Literal, get_args

import numpy as np

from datagen.schema import SPLITS, EditKind

Stream = Literal["scene", "sensor", "rig", EditKind, "tracks"]
"""Purpose of random numbers: sampling a scene, the sensor's noise, cameras of a new rig, one kind of edit, or the
choice of tracked points."""

_STREAMS: tuple[Stream, ...] = get_args(Stream)
_POOL_KEY = 20261120


def scene_rng(seed: int, split: str, index: int, stream: Stream) -> np.random.Generator:
    """Make the generator of one purpose in scene `index` of a split."""
    return np.random.default_rng([seed, SPLITS.index(split), index, _STREAMS.index(stream)])


def pool_rng(category: int, shape_id: int) -> np.random.Generator:
    """Make the generator of a shape from a category's pool, which is equal in every recipe, scene and split."""
    return np.random.default_rng([_POOL_KEY, category, shape_id])
