"""Point-wise heads on the backbone's embedding (paper, section Encoder; pre-scope in section IC-SBP)."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import log_softmax, pad

from obpose.config import ModelConfig
from obpose.model.backbone import EMBEDDING
from obpose.model.layers.mlp import Linear, mlp
from obpose.types import GridPoints, GridValid, Prescope

COLOUR = 8
"""D_c: channels of the colour embeddings, which the attention clusters. The position is added to three of them, the
colour to three more. [code]"""
FEATURE = 16
"""D_f: channels of the features, which the encoders use. [code]"""
_HIDDEN = 32
"""Width of the heads' hidden layer. [code]"""


class HeadOutputs(NamedTuple):
    """Outputs of the heads for each point; arbitrary where the point is not valid."""

    colour: Float[Tensor, "batch frame point colour"]
    """zeta_c, for the IC-SBP; without channels for slot attention."""
    features: Float[Tensor, "batch frame point feature"]
    """zeta_f for the other encoders, and the standardised colours if wanted; without channels if there is no head."""
    log_prescope: Prescope | None
    """Log of s^p: the background's mask, then the scope s_0 that the objects share. None without a background."""


class Heads(nn.Module):
    """Colour, feature and pre-scope head; for slot attention only the feature head.

    Deviations from the paper:

    - The position enters the colour head through a linear layer, as in the authors' code. Times a constant, it is also
      added to the first three output channels (semi-convolutional embedding, Novotny et al. 2018). Without it, nothing
      distinguishes equal objects at the start.
    - The colour is added to the next three channels. Without it, touching objects stay merged for long.
    - The pre-scope is read before these additions: being background should not depend on the place on the table.
    - ReLU instead of the authors' ELU, which takes a notable part of a training step on a CPU.
    - The observed colours are appended to zeta_f, so that the latents need not wait for the backbone.
    """

    def __init__(self, config: ModelConfig):
        super().__init__()
        attention, icsbp = config.attention, config.attention.kind == "icsbp"
        self.semi_convolution, self.semi_colour = attention.semi_convolution, attention.semi_colour
        self.appends_colours = config.latent.colours == "given"
        self.colour = self.prescope = None
        # zeta_c, from the embedding and the position (paper, section Encoder).
        if icsbp:
            self.position = Linear(3, EMBEDDING, bias=False)
            self.colour = mlp(EMBEDDING, _HIDDEN, COLOUR, activation=nn.ReLU)
        # zeta_f.
        self.features = mlp(EMBEDDING, _HIDDEN, FEATURE, activation=nn.ReLU)
        # rho: the logits of the pre-scope s^p (paper, eq. 3).
        if icsbp and config.has_background:
            self.prescope = mlp(COLOUR, _HIDDEN, 2, activation=nn.ReLU)

    @property
    def feature_size(self) -> int:
        """Channels of the features."""
        return FEATURE + (3 if self.appends_colours else 0)

    def forward(
        self,
        points: GridPoints,
        valid: GridValid,
        rgb: GridPoints,
        embedding: Float[Tensor, "batch frame point embedding"],
        *,
        center: Float[Tensor, "3"],
    ) -> HeadOutputs:
        """Apply the heads.

        `points` are in the world frame, metres, `rgb` standardised, `center` is the middle of the workspace.
        """
        # zeta_f, and the observed colours.
        features = self.features(embedding)
        if self.appends_colours:
            features = torch.cat([features, rgb], dim=-1)
        if self.colour is None:
            return HeadOutputs(embedding[..., :0], features, None)
        # zeta_c, and the pre-scope s^p = softmax(rho(zeta_c)).
        position = (points - center) * valid[..., None]
        colour = self.colour(embedding + self.position(position))
        log_prescope = None if self.prescope is None else log_softmax(self.prescope(colour), dim=-1)
        # Semi-convolutional embedding: position, then colour.
        shift = torch.cat([self.semi_convolution * position, self.semi_colour * rgb], dim=-1)
        colour = colour + pad(shift, (0, colour.shape[-1] - shift.shape[-1]))
        return HeadOutputs(colour, features, log_prescope)
