"""Neural field of a slot: density from point and slot, colour also from ray and image."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from obpose.baselines.obsurf.config import DecoderConfig

DEPTH = 4
"""Number of hidden layers. [code]"""


class SlotField(nn.Module):
    """MLP in which the input of every hidden layer is shifted and scaled by the slot ("ain" in the published code).

    Density does not depend on the image's features. As published, nothing is normalised. The published code has another
    linear layer before the one of the colours, which is redundant.
    """

    def __init__(self, config: DecoderConfig, *, code: int, slot: int, pixel: int):
        """Initialise the weights, for codes of points, slots and image features with these numbers of channels."""
        super().__init__()
        self.config = config
        inputs = [code] + [config.width] * (DEPTH - 1)
        self.shifts = nn.ModuleList(nn.Linear(slot, size) for size in inputs)
        scales = [nn.Linear(slot, size) for size in inputs]
        if config.unit_scales:
            for scale in scales:
                nn.init.ones_(scale.bias)
        self.scales = nn.ModuleList(scales)
        self.hidden = nn.ModuleList(nn.Linear(size, config.width) for size in inputs)
        self.density_logit = nn.Linear(config.width, 1)
        self.colour_hidden = nn.Linear(config.width, config.width)
        self.colour_seen = nn.Linear(3 + (pixel if config.pixel_features else 0), config.width, bias=False)
        self.colour_out = nn.Linear(config.width, 3)

    def density(
        self, encoded: Float[Tensor, "image point code"], slots: Float[Tensor, "image slot width"]
    ) -> tuple[Float[Tensor, "image slot point"], Float[Tensor, "image slot point hidden"]]:
        """Compute density logits of all slots at points given by their Fourier code, and hidden values for `colour`."""
        values = encoded[:, None]
        for shift, scale, layer in zip(self.shifts, self.scales, self.hidden, strict=True):
            values = layer((values + shift(slots)[:, :, None]) * scale(slots)[:, :, None]).relu_()
        return self.density_logit(values)[..., 0], values

    def colour(
        self,
        hidden: Float[Tensor, "image slot point hidden"],
        directions: Float[Tensor, "image point 3"],
        pixels: Float[Tensor, "image point pixel"],
    ) -> Float[Tensor, "image slot point 3"]:
        """Compute colours in 0..1 along unit directions, with the image's features at the points' pixels."""
        seen = torch.cat([directions, pixels], dim=-1) if self.config.pixel_features else directions
        values = F.relu(self.colour_hidden(hidden) + self.colour_seen(seen)[:, None])
        return torch.sigmoid(self.colour_out(values))
