"""Sampling of new scenes for the viewer, with the seeds 0, 1, 2 and so on."""

import torch

from obpose.errors import UsageError
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors import load_prior
from obpose.scenes.priors.interface import ScenePrior
from obpose.scenes.priors.sample import sample_scene
from obpose.scenes.scene import Camera, Scene

MOST_SAMPLED = 8
"""Largest number of objects of a sampled scene."""
COUNTS = tuple(str(count) for count in range(MOST_SAMPLED + 1))
"""Numbers of objects that the page offers, as text."""


def checked_count(value: str) -> int:
    """Parse the number of objects chosen on the page, which may send any text.

    Raises:
        UsageError: the text is no whole number from 0 to `MOST_SAMPLED`.
    """
    if value not in COUNTS:
        raise UsageError(f"New objects: {value!r:.20}; expected a whole number from 0 to {MOST_SAMPLED}.")
    return int(value)


class Sampler:
    """Sampler of new scenes from the best prior of a model."""

    def __init__(self, origin: Origin):
        self._origin = origin
        self._prior: ScenePrior | None = None
        self.seed = -1
        """Seed of the newest scene; -1 before the first."""

    def next(self, objects: int, cameras: tuple[Camera, ...]) -> Scene:
        """Sample a scene with the next seed.

        Raises:
            UsageError: there is no room for so many objects.
            CorruptFile: the file of a prior is damaged.
        """
        if self._prior is None:
            self._prior = load_prior(self._origin)
        self.seed += 1
        generator = torch.Generator().manual_seed(self.seed)
        return sample_scene(self._origin, self._prior, objects=objects, cameras=cameras, generator=generator)
