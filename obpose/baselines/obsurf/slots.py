"""Slot attention (Locatello et al. 2020) with self-attention between slots, as ObSuRF has it."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from obpose.baselines.obsurf.config import SlotConfig

_LEAST_HIDDEN = 128
_EPSILON = 1e-8


@dataclass(frozen=True, eq=False)
class Slots:
    """What slot attention found in images."""

    codes: Float[Tensor, "image slot width"]
    attention: Float[Tensor, "image slot token"]
    """Of the last iteration; at each token the slots' shares sum to one."""


class SlotAttention(nn.Module):
    """Slots compete for tokens, a few times over.

    Mean and deviation of the first slots are drawn once and kept, as in the published code, where no gradient reaches
    them.
    """

    mean: Tensor
    spread: Tensor
    evaluation_noise: Tensor

    def __init__(self, config: SlotConfig, *, slots: int, width: int):
        """Slots and tokens have the same width."""
        super().__init__()
        self.config = config
        self.register_buffer("mean", torch.randn(width))
        self.register_buffer("spread", torch.randn(width))
        # Slots that all began at the mean would stay equal. These draws stand in for noise at evaluation; they are
        # saved with the weights, so that equal images get equal labels.
        self.register_buffer("evaluation_noise", torch.randn(slots, width))
        self.token_norm, self.slot_norm, self.mlp_norm = (nn.LayerNorm(width) for _ in range(3))
        self.query, self.key, self.value = (nn.Linear(width, width) for _ in range(3))
        self.update = nn.GRUCell(width, width)
        self.between = nn.MultiheadAttention(width, config.heads, batch_first=True)
        hidden = max(width, _LEAST_HIDDEN)
        self.mlp = nn.Sequential(nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, width))

    def forward(self, tokens: Float[Tensor, "image token width"], noise: Float[Tensor, "image slot width"]) -> Slots:
        """Slots of each image; `noise` is standard normal, or `evaluation_noise`."""
        tokens = self.token_norm(tokens)
        keys, values = self.key(tokens), self.value(tokens)
        slots = self.first_slots(noise)
        attention = tokens.new_zeros(0)
        for _ in range(self.config.iterations):
            attention = compete(self.query(self.slot_norm(slots)), keys)
            updates = gather(attention, values)
            slots = self.update(updates.flatten(0, 1), slots.flatten(0, 1)).view_as(slots)
            slots = slots + self.between(slots, slots, slots, need_weights=False)[0]
            slots = slots + self.mlp(self.mlp_norm(slots))
        return Slots(slots, attention)

    def first_slots(self, noise: Float[Tensor, "*shape width"]) -> Float[Tensor, "*shape width"]:
        """Draws from the slot distribution N(mean, softplus(spread)^2)."""
        return self.mean + F.softplus(self.spread) * noise


def compete(
    queries: Float[Tensor, "image slot width"], keys: Float[Tensor, "image token width"]
) -> Float[Tensor, "image slot token"]:
    """Each token's shares for the slots: softmax over slots of q k / sqrt D (Locatello et al. 2020, eq. 1)."""
    return torch.softmax(queries @ keys.mT / keys.shape[-1] ** 0.5, dim=1)


def gather(
    attention: Float[Tensor, "image slot token"], values: Float[Tensor, "image token width"]
) -> Float[Tensor, "image slot width"]:
    """Each slot's mean of the values of its tokens (Locatello et al. 2020, eq. 2)."""
    weights = attention + _EPSILON
    return weights / weights.sum(dim=-1, keepdim=True) @ values
