"""Random numbers of a training, one stream per purpose; each is a function of `(seed, stream, place)` alone.

A run therefore resumes exactly without saved generator states, and no clip depends on those before it.
"""

from typing import Literal

import numpy as np

Stream = Literal["epoch", "window", "noise", "pasted image", "choice of images"]
"""Purpose of random numbers: the order of the clips of an epoch, the first frames of a step's windows, the noise of a
step, what is pasted into an image, or the images that are pasted for a window."""

_NUMBERS: dict[Stream, int] = {"epoch": 0, "window": 1, "noise": 2, "pasted image": 2, "choice of images": 3}
"""Numbers of the streams, which trained weights depend on. Noise and pasted images share one, but are drawn by
different kinds of generators."""


def training_rng(seed: int, stream: Stream, *place: int) -> np.random.Generator:
    """Make the generator of one purpose at a place, such as a step."""
    return np.random.default_rng([seed, _NUMBERS[stream], *place])


def training_seed(seed: int, stream: Stream, *place: int) -> int:
    """Make the seed of another library's generator for one purpose at a place."""
    return int(np.random.SeedSequence([seed, _NUMBERS[stream], *place]).generate_state(1)[0])
