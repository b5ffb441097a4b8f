"""The `where` module: offset of an object's centre from the centre of its observed points.

Paper, section Object Location and Orientation Conditioned Encoding. Its input are unrotated boxes at the observed
centres, {T, I}.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from obpose.config import ModelConfig
from obpose.model.layers.latent import LATENT, RecurrentLatent
from obpose.model.layers.mlp import mlp
from obpose.types import Draw, Latent

_TRANSLATION_WIDTH = 256
"""Hidden width of f_where. [code]"""


class Where(nn.Module):
    """q(z_where | x_<=t), its prior, and the translation that z_where stands for."""

    def __init__(self, code: int, config: ModelConfig):
        """Initialise the weights, for codes with `code` channels."""
        super().__init__()
        self._latent = RecurrentLatent(code, config.latent, weights=config.weights)
        self._translation = mlp(LATENT, _TRANSLATION_WIDTH, 3)
        self._max_translation = config.pose.max_translation

    def forward(
        self, code: Float[Tensor, "batch frame slot code"], draw: Draw, generator: torch.Generator | None = None
    ) -> Latent:
        """z_where from the object encoder's codes."""
        return self._latent(code, draw, generator)

    def translation(self, z: Float[Tensor, "*shape latent"]) -> Float[Tensor, "*shape 3"]:
        """Delta T = T_max tanh(f_where(z_where)), world frame, metres (paper, the equation after eq. transform)."""
        return self._max_translation * torch.tanh(self._translation(z))
