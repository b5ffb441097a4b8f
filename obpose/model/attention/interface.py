"""Interface of the attention parts, which turn embeddings of points into masks, and means under masks."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn

from obpose.types import ComponentMasks, Embeddings, GridValid, Masks, SlotMasks

EXCLUDED = -1e4
"""Log mask of inactive slots, and of all slots at invalid points: lower than any other, finite in half precision."""


@dataclass(frozen=True, eq=False)
class Attended:
    """Output of an attention part."""

    masks: Masks
    slot_codes: Float[Tensor, "batch frame slot code"] | None
    """Codes of the objects; None if they have to be encoded from the points under their masks."""
    background_code: Float[Tensor, "batch frame code"] | None
    """Code of the background; None without one."""


class Attention(nn.Module, ABC):
    """Part that divides the points of all frames among the background and the slots."""

    @abstractmethod
    def forward(self, embeddings: Embeddings, generator: torch.Generator | None) -> Attended:
        """Compute masks of all frames; without randomness in evaluation mode."""

    @abstractmethod
    def background_code(self, embeddings: Embeddings, generator: torch.Generator | None) -> Tensor:
        """Compute the code of the background alone, for the warm-up."""


_LEAST = 1e-6
"""Smallest divisor, for empty masks."""


def mean_under(
    log_masks: SlotMasks, valid: GridValid, values: Float[Tensor, "batch frame point value"]
) -> Float[Tensor, "batch frame slot value"]:
    """Mean over the valid points, weighted by the mask, which gets a gradient; 0 where there are none."""
    weights = log_masks.exp() * rearrange(valid, "b f point -> b f 1 point")
    return weights @ torch.where(valid[..., None], values, 0.0) / weights.sum(dim=-1, keepdim=True).clamp(min=_LEAST)


def not_largest(log_masks: ComponentMasks) -> Float[Tensor, "batch frame point"]:
    """One minus the mask of a clip's largest component: where objects are, if that is the background."""
    masks = log_masks.exp()
    largest = masks.sum(dim=(1, 3)).argmax(dim=1)
    return (1 - masks[torch.arange(len(masks)), :, largest]).clamp(min=0.0)
