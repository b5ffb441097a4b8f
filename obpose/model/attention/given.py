"""Masks from a given segmentation, in place of an attention part's."""

import torch
from einops import rearrange
from jaxtyping import Int
from torch import Tensor

from obpose.model.attention.interface import EXCLUDED, Attended, Attention
from obpose.types import Embeddings, Masks

Labels = Int[Tensor, "batch frame view height width"]


class GivenMasks(Attention):
    """Part without weights for models whose masks are given: without a segmentation there are no objects."""

    def forward(self, embeddings: Embeddings, generator: torch.Generator | None) -> Attended:
        """Give every point to the background, and none to the one slot, which is inactive."""
        batch, frames, points = embeddings.valid.shape
        nothing = embeddings.valid.new_zeros((batch, frames, 1, 1, points), dtype=torch.int64)
        return attended_as_labelled(nothing, embeddings, self, grid=(1, points))

    def background_code(self, embeddings: Embeddings, generator: torch.Generator | None) -> Tensor:
        """Code of the scene."""
        return embeddings.scene


def attended_as_labelled(
    labels: Labels, embeddings: Embeddings, attention: Attention, *, grid: tuple[int, int]
) -> Attended:
    """Give masks that are 1 where a slot's label is, with as many slots as the largest label.

    Args:
        labels: Objects from 1, the same over time; 0 = background.
        embeddings: Embeddings of the same frames.
        attention: Part that gives the code of the background.
        grid: Rows and columns of the embedding grid of an image; a cell has the label of its middle pixel.
    """
    # Labels of the cells; cells without a point count as background.
    height, width = labels.shape[-2:]
    rows, columns = (
        ((torch.arange(cells) + 0.5) * -(-length // cells)).long().clamp(max=length - 1).to(labels.device)
        for cells, length in zip(grid, (height, width), strict=True)
    )
    cells = rearrange(labels[..., rows[:, None], columns], "b f v h w -> b f (v h w)") * embeddings.valid
    slots = max(1, int(labels.max()))
    # Masks of 0 and 1, without a remaining scope.
    chosen = cells[:, :, None] == torch.arange(slots + 1, device=labels.device)[:, None]
    log_masks = torch.where(chosen, 0.0, EXCLUDED).to(embeddings.points.dtype)
    masks = Masks(
        log_masks=log_masks,
        log_scope=torch.full_like(log_masks[:, :, 0], EXCLUDED),
        active=chosen[:, :, 1:].any(dim=(1, 3)),
    )
    return Attended(masks, None, attention.background_code(embeddings, None))
