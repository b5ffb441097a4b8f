"""Interface of the attention parts, which turn embeddings of points into masks."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from obpose.types import Embeddings, Masks

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
