"""The `what` module: an object's shape and appearance, seen in its own frame.

Paper, section Object Location and Orientation Conditioned Encoding. It hears of boxes at the objects' poses,
{T_hat, R}.
"""

from obpose.config import LatentConfig, Weights
from obpose.model.layers.latent import RecurrentLatent


class What(RecurrentLatent):
    """q(z_what | x_<=t) and its prior, from the object encoder's codes."""

    def __init__(self, encoding: int, latent: LatentConfig, weights: Weights = "orthogonal"):
        super().__init__(encoding, latent.what, latent, weights=weights)
