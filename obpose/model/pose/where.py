"""The `where` module: how far an object's centre is from the centre of its observed points.

Paper, section Object Location and Orientation Conditioned Encoding. It hears of boxes at the observed centres that are
not turned, {T, I}.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from obpose.config import LatentConfig, PoseConfig, Weights
from obpose.model.layers.latent import RecurrentLatent
from obpose.model.layers.mlp import mlp
from obpose.types import Draw, Latent

_TRANSLATION_WIDTH = 256
"""Hidden width of f_where, the authors'."""


class Where(nn.Module):
    """q(z_where | x_<=t), its prior, and what z_where means."""

    def __init__(self, encoding: int, latent: LatentConfig, pose: PoseConfig, weights: Weights = "orthogonal"):
        super().__init__()
        self._latent = RecurrentLatent(encoding, latent.where, latent, weights=weights)
        self._translation = mlp(latent.where, _TRANSLATION_WIDTH, 3)
        self._max_translation = pose.max_translation

    def forward(
        self,
        encoding: Float[Tensor, "batch frame slot encoding"],
        draw: Draw,
        generator: torch.Generator | None = None,
    ) -> Latent:
        """z_where from the object encoder's codes."""
        return self._latent(encoding, draw, generator)

    def translation(self, z: Float[Tensor, "*shape latent"]) -> Float[Tensor, "*shape 3"]:
        """Delta T = T_max tanh(f_where(z_where)), world frame, metres (paper, the equation after eq. transform)."""
        return self._max_translation * torch.tanh(self._translation(z))
