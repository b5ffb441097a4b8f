"""Slot attention (Locatello et al. 2020) with self-attention between slots, as in ObSuRF."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

ITERATIONS = 5
"""Iterations of the slot attention. [code]"""
HEADS = 4
"""Heads of the self-attention between slots after each iteration. [code]"""
_LEAST_HIDDEN = 128
"""Smallest hidden width of the MLP."""
_EPSILON = 1e-8
"""Value added to the attention before it is normalised over tokens."""


@dataclass(frozen=True, eq=False)
class Slots:
    """Slots of images."""

    codes: Float[Tensor, "image slot width"]
    attention: Float[Tensor, "image slot token"]
    """Attention of the last iteration; it sums to one over the slots at each token."""


class SlotAttention(nn.Module):
    """Slots that compete for tokens in a few iterations.

    As in the published code, mean and standard deviation of the first slots are drawn once and not learned.
    """

    mean: Tensor
    spread: Tensor
    evaluation_noise: Tensor

    def __init__(self, *, slots: int, width: int, iterations: int = ITERATIONS):
        """Initialise the weights; slots and tokens have the same width."""
        super().__init__()
        self._iterations = iterations
        self.register_buffer("mean", torch.randn(width))
        self.register_buffer("spread", torch.randn(width))
        # Slots that start from the mean would stay equal. This noise replaces random noise at evaluation, and is saved
        # with the weights, so that equal images get equal labels.
        self.register_buffer("evaluation_noise", torch.randn(slots, width))
        self.token_norm, self.slot_norm, self.mlp_norm = (nn.LayerNorm(width) for _ in range(3))
        self.query, self.key, self.value = (nn.Linear(width, width) for _ in range(3))
        self.update = nn.GRUCell(width, width)
        self.between = nn.MultiheadAttention(width, HEADS, batch_first=True)
        hidden = max(width, _LEAST_HIDDEN)
        self.mlp = nn.Sequential(nn.Linear(width, hidden), nn.ReLU(), nn.Linear(hidden, width))

    def forward(self, tokens: Float[Tensor, "image token width"], noise: Float[Tensor, "image slot width"]) -> Slots:
        """Compute the slots of each image; `noise` is standard normal, or `evaluation_noise`."""
        tokens = self.token_norm(tokens)
        keys, values = self.key(tokens), self.value(tokens)
        slots = self.first_slots(noise)
        attention = tokens.new_zeros(0)
        for _ in range(self._iterations):
            attention = compete(self.query(self.slot_norm(slots)), keys)
            updates = gather(attention, values)
            slots = self.update(updates.flatten(0, 1), slots.flatten(0, 1)).view_as(slots)
            slots = slots + self.between(slots, slots, slots, need_weights=False)[0]
            slots = slots + self.mlp(self.mlp_norm(slots))
        return Slots(slots, attention)

    def first_slots(self, noise: Float[Tensor, "*shape width"]) -> Float[Tensor, "*shape width"]:
        """Draw slots from N(mean, softplus(spread)^2)."""
        return self.mean + F.softplus(self.spread) * noise


def compete(
    queries: Float[Tensor, "image slot width"], keys: Float[Tensor, "image token width"]
) -> Float[Tensor, "image slot token"]:
    """Attention of slots to tokens: softmax over slots of q k / sqrt D (Locatello et al. 2020, eq. 1)."""
    return torch.softmax(queries @ keys.mT / keys.shape[-1] ** 0.5, dim=1)


def gather(
    attention: Float[Tensor, "image slot token"], values: Float[Tensor, "image token width"]
) -> Float[Tensor, "image slot width"]:
    """Mean of the values of each slot's tokens (Locatello et al. 2020, eq. 2)."""
    weights = attention + _EPSILON
    return weights / weights.sum(dim=-1, keepdim=True) @ values
