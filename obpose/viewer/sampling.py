"""New scenes for the viewer: the seeds 0, 1, 2 and so on."""

import torch

from obpose.creation.origin import Origin
from obpose.creation.prior import FILE, ScenePrior, learned_prior, load_prior
from obpose.creation.sample import sample_scene
from obpose.creation.scene import Camera, Scene


class Sampler:
    """Scenes of one model that were never seen, from the Gaussians beside its weights, else from its own priors."""

    def __init__(self, origin: Origin):
        self._origin = origin
        self._prior: ScenePrior | None = None
        self.seed = -1
        """Of the newest scene."""

    def next(self, objects: int, cameras: tuple[Camera, ...]) -> Scene:
        """The scene of the next seed.

        Raises:
            UsageError: there is no room for so many objects.
            CorruptFile: the file of the Gaussians is damaged.
        """
        if self._prior is None:
            fitted = (self._origin.folder / FILE).is_file()
            self._prior = load_prior(self._origin) if fitted else learned_prior(self._origin.model)
        self.seed += 1
        generator = torch.Generator().manual_seed(self.seed)
        return sample_scene(self._origin, self._prior, objects=objects, cameras=cameras, generator=generator)
