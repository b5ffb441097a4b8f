"""Point-wise heads on the backbone's embedding (paper, section Encoder; pre-scope in section IC-SBP)."""

from typing import Literal, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.functional import log_softmax, pad

from obpose.config import AttentionConfig, BackboneConfig
from obpose.model.layers.mlp import Linear, mlp

_HIDDEN = 32
"""Width of the heads' hidden layer, as in the authors' code."""


class HeadOutputs(NamedTuple):
    """What the heads say of each point; where it is not valid, that does not matter."""

    colour: Float[Tensor, "batch frame point colour"]
    """zeta_c, for the IC-SBP; without channels for slot attention."""
    features: Float[Tensor, "batch frame point feature"]
    """zeta_f, for the other encoders; without channels where there are none."""
    log_prescope: Float[Tensor, "batch frame point 2"] | None
    """Log of s^p: the background's mask, then the scope s_0 that the objects share. None where there is none."""


class Heads(nn.Module):
    """Colour, feature and pre-scope head; only the feature head for slot attention.

    Deviations from the paper: the position enters the colour head through a linear layer, as in the authors' code,
    and is added to the first three channels of its output, times a constant (semi-convolutional embedding, Novotny et
    al. 2018), because without it nothing tells equal objects apart at the start. So is the colour to the next three:
    without it objects that touch are one for long. The pre-scope is read from the embedding before these additions:
    whether a point is background should not change along the table. ReLU in place of the authors' ELU,
    which with an embedding for every pixel is a notable part of a training step on a CPU.
    """

    def __init__(
        self,
        backbone: BackboneConfig,
        attention: AttentionConfig,
        *,
        background: Literal["component", "none"] = "component",
        features: bool = True,
    ):
        """Pre-scope and features can be left out."""
        super().__init__()
        self.semi_convolution = attention.semi_convolution
        self.semi_colour = attention.semi_colour
        self.colour = self.features = self.prescope = None
        if attention.kind == "icsbp":
            self.position = Linear(3, backbone.embedding, bias=False)
            self.colour = mlp(backbone.embedding, _HIDDEN, backbone.colour, activation=nn.ReLU)
        if features:
            self.features = mlp(backbone.embedding, _HIDDEN, backbone.feature, activation=nn.ReLU)
        if attention.kind == "icsbp" and background == "component":
            self.prescope = mlp(backbone.colour, _HIDDEN, 2, activation=nn.ReLU)

    def forward(
        self,
        points: Float[Tensor, "batch frame point 3"],
        valid: Bool[Tensor, "batch frame point"],
        rgb: Float[Tensor, "batch frame point 3"],
        embedding: Float[Tensor, "batch frame point embedding"],
        *,
        center: Float[Tensor, "3"],
    ) -> HeadOutputs:
        """Apply the heads.

        `points` are in the world frame, metres, `rgb` standardised, `center` is the middle of the workspace.
        """
        features = embedding[..., :0] if self.features is None else self.features(embedding)
        if self.colour is None:
            return HeadOutputs(embedding[..., :0], features, None)
        position = (points - center) * valid[..., None]
        colour = self.colour(embedding + self.position(position))
        seen = torch.cat([self.semi_convolution * position, self.semi_colour * rgb], dim=-1)
        shift = pad(seen, (0, colour.shape[-1] - seen.shape[-1]))
        return HeadOutputs(
            colour=colour + shift,
            features=features,
            log_prescope=None if self.prescope is None else log_softmax(self.prescope(colour), dim=-1),
        )
