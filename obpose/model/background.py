"""The background's latent z_bg, from the scene codes of the frames (paper, section Methods).

The paper has z^bg in its figure of the model alone and says nothing of its posterior and prior.
"""

from obpose.config import LatentConfig, Weights
from obpose.model.layers.latent import RecurrentLatent


class BackgroundLatent(RecurrentLatent):
    """q(z_bg | x_<=t) and its prior; as in the authors' code both start at learned hidden states."""

    def __init__(self, scene: int, latent: LatentConfig, weights: Weights = "orthogonal"):
        super().__init__(scene, latent.background, latent, weights=weights, start="learned")
