"""New scenes for the viewer: the seeds 0, 1, 2 and so on."""

import torch

from obpose.creation.flow_prior import FlowPrior, has_flow, named_prior
from obpose.creation.origin import Origin
from obpose.creation.prior import FILE, ScenePrior
from obpose.creation.sample import sample_scene
from obpose.creation.scene import Camera, Scene
from obpose.errors import UsageError

MOST_SAMPLED = 8
"""Objects of a sampled scene."""
COUNTS = tuple(str(count) for count in range(MOST_SAMPLED + 1))
"""Numbers to choose from."""


def checked_count(value: str) -> int:
    """Give the number of objects that was chosen on the page, from which any text may come.

    Raises:
        UsageError: it is no whole number in 0 to `MOST_SAMPLED`.
    """
    if value not in COUNTS:
        raise UsageError(f"New objects: {value!r:.20}; expected a whole number from 0 to {MOST_SAMPLED}.")
    return int(value)


class Sampler:
    """Scenes of one model that were never seen, from the best of its priors."""

    def __init__(self, origin: Origin):
        self._origin = origin
        self._prior: FlowPrior | ScenePrior | None = None
        self.seed = -1
        """Of the newest scene."""

    def next(self, objects: int, cameras: tuple[Camera, ...]) -> Scene:
        """The scene of the next seed.

        Raises:
            UsageError: there is no room for so many objects.
            CorruptFile: the file of a prior is damaged.
        """
        if self._prior is None:
            self._prior = _best_prior(self._origin)
        self.seed += 1
        generator = torch.Generator().manual_seed(self.seed)
        return sample_scene(self._origin, self._prior, objects=objects, cameras=cameras, generator=generator)


def _best_prior(origin: Origin) -> FlowPrior | ScenePrior:
    """The flow that was learned, else the mixtures that were fitted, else what the model has by itself."""
    if has_flow(origin):
        return named_prior(origin, "flow")
    return named_prior(origin, "fitted" if (origin.folder / FILE).is_file() else "learned")
