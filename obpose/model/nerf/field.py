"""Generative neural radiance field: point, view direction and latent to density and colour (paper, section Decoder).

Terms that depend on the latent alone are computed once per code (`Field.condition`) and added to those of the points.
Codes broadcast to points: all points of a frame may share one, or each point of a flat list may have its own.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from obpose.config import FieldConfig, Weights
from obpose.model.layers.mlp import pass_on
from obpose.model.nerf.detail import Detail


@dataclass(frozen=True, eq=False)
class Conditioning:
    """Terms that latents add to a field's layers."""

    first: Float[Tensor, "*code width"]
    again: Float[Tensor, "*code width"]
    colour: Float[Tensor, "*code width"]
    detail: Detail | None = None
    """Corrections of the output; only for codes with at most one axis."""

    def of_all_points(self) -> "Conditioning":
        """Add an axis, before the last, for the points that share a code."""
        assert self.detail is None
        return Conditioning(self.first[..., None, :], self.again[..., None, :], self.colour[..., None, :])

    def flatten(self) -> "Conditioning":
        """Flatten codes of batch x frame to a list."""
        assert self.detail is None
        return Conditioning(self.first.flatten(0, 1), self.again.flatten(0, 1), self.colour.flatten(0, 1))

    def at(self, owner: Int[Tensor, " n"]) -> "Conditioning":
        """Select a code for each of a flat list of points; `owner` is its index."""
        detail = self.detail and self.detail.at(owner)
        return Conditioning(self.first[owner], self.again[owner], self.colour[owner], detail)

    def corrected(self, detail: Detail | None) -> "Conditioning":
        """Add corrections of one object per code; None for no corrections."""
        return replace(self, detail=detail)


class Hidden(NamedTuple):
    """Hidden values from which colours are computed."""

    values: Float[Tensor, "*value width"]
    correction: Float[Tensor, "*value 3"] | None
    """Correction of the logits of the colours."""


class Field(nn.Module):
    """ReLU MLP on the positional encoding of the point, to which the latent is added.

    The paper does not specify the layers. As in the authors' code, latent and point enter by addition, at the first
    layer and again after the middle one. There they are added before the next layer's activation (as the point in
    Mildenhall et al. 2020), not to its input: the same functions with fewer copies.
    """

    def __init__(self, config: FieldConfig, latent: int, weights: Weights = "orthogonal") -> None:
        """Initialise the weights, for codes with `latent` channels."""
        super().__init__()
        width = config.width
        self.config = config
        # Density: hidden layers with the point at the first and again after the middle one.
        self.first = nn.Linear(6 * config.position_frequencies, width)
        self.hidden = nn.ModuleList(nn.Linear(width, width) for _ in range(config.depth - 1))
        self.again = nn.Linear(6 * config.position_frequencies, width, bias=False)
        self.density_logit = nn.Linear(width, 1)
        # Colour, which also depends on the view direction.
        self.colour_hidden = nn.Linear(width, width)
        self.colour_direction = nn.Linear(6 * config.direction_frequencies, width, bias=False)
        self.colour_out = nn.Linear(width, 3)
        # Terms of the latent for three of the layers.
        self.codes = nn.Linear(latent, 3 * width, bias=False)
        if weights == "orthogonal":
            pass_on(self.codes)

    def condition(self, codes: Float[Tensor, "*code latent"]) -> Conditioning:
        """Compute the terms that latents add to the layers."""
        return Conditioning(*self.codes(codes).chunk(3, dim=-1))

    def density(
        self, points: Float[Tensor, "*points 3"], codes: Conditioning
    ) -> tuple[Float[Tensor, "*value"], Hidden]:
        """Density logits at points, -1..1 in the field's box, and hidden values for `colour`; codes broadcast."""
        # Hidden layers; point and latent enter at the first layer and again after the middle one.
        encoded = positional_encoding(points, self.config.position_frequencies)
        # In place only on results of additions, because autograd copies the views that nn.Linear gives.
        hidden = (self.first(encoded) + codes.first).relu_()
        for place, layer in enumerate(self.hidden):
            if place == min(self.config.depth // 2, len(self.hidden) - 1):
                hidden = (layer(hidden) + self.again(encoded)).add_(codes.again).relu_()
            else:
                hidden = layer(hidden).relu()
        # Density, corrected by the residual grid.
        logit, correction = self.density_logit(hidden)[..., 0], None
        if codes.detail is not None:
            density, correction = codes.detail.of(points).split([1, 3], dim=-1)
            logit = (logit[..., None] * codes.detail.corrects() + density)[..., 0]
        return logit if self.config.density == "raw" else squash(logit), Hidden(hidden, correction)

    def colour(
        self, hidden: Hidden, directions: Float[Tensor, "*points 3"], codes: Conditioning
    ) -> Float[Tensor, "*value 3"]:
        """Colours in 0..1 along unit directions."""
        encoded = positional_encoding(directions, self.config.direction_frequencies)
        # View direction and latent enter by addition.
        seen = (self.colour_hidden(hidden.values) + self.colour_direction(encoded)).add_(codes.colour).relu_()
        logits = self.colour_out(seen)
        if codes.detail is not None:
            logits = logits * codes.detail.corrects() + hidden.correction
        return torch.sigmoid(logits)


def squash(logit: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Logit of the authors' slot attention for video: 10 times the sigmoid of the network's output.

    It is never below 0, so that two components have a density of at least tanh(2 ln 2) = .88 everywhere, and five of
    .998, whatever the weights.
    """
    return 10 * torch.sigmoid(logit)


def positional_encoding(points: Float[Tensor, "*shape 3"], frequencies: int) -> Float[Tensor, "*shape encoding"]:
    """Sines and cosines of 2^i pi p for i below `frequencies` (Mildenhall et al. 2020, eq. 4), without p itself."""
    scales = math.pi * 2.0 ** torch.arange(frequencies, dtype=points.dtype, device=points.device)
    quarters = torch.tensor([0, math.pi / 2], dtype=points.dtype, device=points.device)
    angles = torch.addcmul(quarters.repeat_interleave(frequencies), points[..., None], scales.repeat(2))
    return angles.sin().flatten(start_dim=-2)
