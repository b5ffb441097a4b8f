"""A slot's neural field: density from the point and the slot, colour also from the ray and the image."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from obpose.baselines.obsurf.config import DecoderConfig


class SlotField(nn.Module):
    """An MLP in which every hidden layer's input is shifted and scaled by the slot ("ain" in the published code).

    Density never sees the image's features. As published nothing is normalised. Between the last hidden layer and the
    colours the published code has a linear layer more, which changes nothing before another.
    """

    def __init__(self, config: DecoderConfig, *, code: int, slot: int, pixel: int):
        """Sizes of the points' code, of slots, and of the image's features."""
        super().__init__()
        self.config = config
        inputs = [code] + [config.width] * (config.depth - 1)
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
        """Density logits of all slots at points given by their Fourier code, and hidden values for `colour`."""
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
        """Colours in 0..1 along unit directions, with the image's features at the points' pixels."""
        seen = torch.cat([directions, pixels], dim=-1) if self.config.pixel_features else directions
        values = F.relu(self.colour_hidden(hidden) + self.colour_seen(seen)[:, None])
        return torch.sigmoid(self.colour_out(values))
