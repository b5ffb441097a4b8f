"""How far the backbone and the IC-SBP get where labels are to be had: the same masks, trained with labels.

Not a competitor of the others but a mark to read them against, and the only model that is given labels.
"""

import torch
from einops import rearrange
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from obpose.config import Config
from obpose.geometry import unproject
from obpose.model.losses.observation import mean_over
from obpose.model.losses.regularisers import remaining_scope
from obpose.model.perception import Perception
from obpose.types import LabelledObservation, Observation, Segmentation

_CROSS_ENTROPY, _SCOPE = 10.0, 0.25
"""Weights of the two terms. [ours]"""


class Supervised(Perception):
    """Backbone, colour and pre-scope head and IC-SBP of ObPose; nothing is decoded."""

    sees = LabelledObservation

    def __init__(self, config: Config):
        super().__init__(config, encoded="masks")

    def losses(
        self, observation: Observation, *, step: int, fraction: float = 0.0, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Cross-entropy of the masks with the labels, objects matched to slots, and what no slot has taken."""
        if not isinstance(observation, LabelledObservation):
            raise TypeError(f"{type(self).__name__} learns from labels; expected a LabelledObservation.")
        observation = self.seen(observation, generator)
        embeddings, log_prescope = self.embed(observation, unproject(observation))
        masks = self.attend(embeddings, log_prescope, generator)
        log_masks = self.log_masks_at_pixels(masks, embeddings.valid, observation)
        labels = rearrange(observation.segmentation, "b f v h w -> b f (v h w)")
        valid = rearrange(observation.valid, "b f v h w -> b f (v h w)")
        terms = {
            "cross_entropy": matched_cross_entropy(log_masks, labels.masked_fill(~valid, _IGNORED)),
            "scope": remaining_scope(masks.log_scope, embeddings.valid),
        }
        total = _CROSS_ENTROPY * terms["cross_entropy"] + _SCOPE * terms["scope"]
        return {"total": total, **{name: term.detach() for name, term in terms.items()}}

    @torch.no_grad()
    def segment(self, observation: Observation) -> Segmentation:
        """The component with the largest mask at every pixel."""
        embeddings, log_prescope = self.embed(observation, unproject(observation))
        owners = self.pixel_owners(self.attend(embeddings, log_prescope, None), embeddings.valid, observation)
        return Segmentation(labels=owners, attention=owners)


_IGNORED = -1
"""Label of pixels that do not count."""
_FLOOR = -12.0
"""Log of the likelihood of an outlier: a pixel far from the seed of its slot, of which a fresh model has many, stops
pulling. Without it nothing else is learned for long. [ours]"""


def matched_cross_entropy(
    log_masks: Float[Tensor, "batch frame component pixel"], labels: Int[Tensor, "batch frame pixel"]
) -> Float[Tensor, ""]:
    """Mean of -log(m + e^floor) of the component that each pixel's object is matched to, over all pixels that count.

    Label 0 is component 0. The other labels of a clip are matched to the slots, one to one over the whole clip, so that
    masks and objects overlap most (Kuhn 1955); which numbers they are does not matter. Objects that are left over where
    there are more than slots do not count, nor do labels below 0.
    """
    components = torch.stack([_matched(*clip) for clip in zip(log_masks.detach(), labels, strict=True)])
    chosen = log_masks.gather(2, components.clamp(min=0)[:, :, None])[:, :, 0]
    unlikely = torch.logaddexp(chosen, chosen.new_tensor(_FLOOR))
    return mean_over(-unlikely, (components >= 0).to(log_masks.dtype))


def _matched(
    log_masks: Float[Tensor, "frame component pixel"], labels: Int[Tensor, "frame pixel"]
) -> Int[Tensor, "frame pixel"]:
    """The component of each pixel of a clip."""
    names = labels.unique()
    objects = names[names > 0]
    components = torch.where(labels == 0, 0, _IGNORED)
    mine = (labels[None] == objects[:, None, None]).to(log_masks.dtype)
    overlap = torch.einsum("fsp,ofp->so", log_masks[:, 1:].exp(), mine)
    slots, matched = linear_sum_assignment(overlap.cpu().numpy(), maximize=True)
    for slot, place in zip(slots, matched, strict=True):
        components = torch.where(labels == objects[place], int(slot) + 1, components)
    return components
