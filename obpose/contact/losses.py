"""Losses of the contact model: foreground, discriminative embedding, and affinities of pixel pairs."""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from obpose.contact.components import offsets, shifted

PULL_MARGIN, PUSH_MARGIN = 0.3, 3.0
"""Distance from the mean embedding below which pixels are not pulled, and between means above which they are not
pushed (De Brabandere et al. 2017)."""
DIVIDED = 2.0
"""Weight of pairs of different objects, of which there are fewer."""

Labels = Int[Tensor, "image height width"]


def foreground_loss(logits: Float[Tensor, "image height width"], labels: Labels) -> Float[Tensor, ""]:
    """Cross-entropy of whether a pixel belongs to an object."""
    return F.binary_cross_entropy_with_logits(logits, (labels > 0).to(logits.dtype))


def embedding_loss(
    embedding: Float[Tensor, "image channel height width"], labels: Labels
) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """Pull of pixels to the mean of their object, and push between means (De Brabandere et al. 2017, equations 1, 2).

    Pixels are weighted by the inverse root of the size of their object, so that small objects count.
    """
    count = max(2, int(labels.max()))
    members = F.one_hot(labels.flatten(1), count + 1)[..., 1:].to(embedding.dtype)
    flat = embedding.flatten(2)
    sizes = members.sum(dim=1)
    means = torch.einsum("icp,ipk->ikc", flat, members) / sizes.clamp(min=1)[..., None]
    # Pull.
    weights = (members * (sizes.clamp(min=1) ** -0.5)[:, None]).sum(dim=-1)
    own = torch.einsum("ikc,ipk->icp", means, members)
    distances = _length(flat - own, dim=1)
    pull = (weights * (distances - PULL_MARGIN).clamp(min=0) ** 2).sum() / weights.sum().clamp(min=1e-6)
    # Push.
    present = (sizes > 0).to(embedding.dtype)
    pairs = present[:, :, None] * present[:, None] * (1 - torch.eye(count, device=labels.device))
    between = _length(means[:, :, None] - means[:, None], dim=-1)
    push = (pairs * (PUSH_MARGIN - between).clamp(min=0) ** 2).sum() / pairs.sum().clamp(min=1)
    return pull, push


def affinity_loss(
    logits: Float[Tensor, "image offset height width"], labels: Labels, *, scale: int = 1
) -> Float[Tensor, ""]:
    """Cross-entropy of whether two pixels of objects belong to the same one, for each of `offsets(scale)`."""
    total, count = logits.new_zeros(()), logits.new_zeros(())
    for channel, offset in enumerate(offsets(scale)):
        here, there = shifted(labels.shape[1:], offset)
        one, other = labels[:, here[0], here[1]], labels[:, there[0], there[1]]
        both, same = (one > 0) & (other > 0), one == other
        weights = both * torch.where(same, 1.0, DIVIDED)
        errors = F.binary_cross_entropy_with_logits(
            logits[:, channel, here[0], here[1]], same.to(logits.dtype), reduction="none"
        )
        total, count = total + (weights * errors).sum(), count + weights.sum()
    return total / count.clamp(min=1)


def _length(vectors: Tensor, dim: int) -> Tensor:
    return (vectors.square().sum(dim) + 1e-6).sqrt()
