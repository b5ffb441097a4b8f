"""Supervised reference: the backbone and the IC-SBP of ObPose, with masks trained with labels."""

import torch
from einops import rearrange
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from obpose.config import SupervisedConfig
from obpose.geometry import unproject
from obpose.model.attention.heads import Heads
from obpose.model.attention.icsbp import ICSBP
from obpose.model.backbone import Backbone
from obpose.model.losses.observation import mean_over
from obpose.model.losses.regularisers import remaining_scope
from obpose.model.perception import embed, log_masks_at_pixels, pixel_owners, select_input_views
from obpose.trainable import Trainable
from obpose.types import Embeddings, LabelledObservation, Masks, Observation, Segmentation

_CROSS_ENTROPY, _SCOPE = 10.0, 0.25
"""Weights of the two terms. [ours]"""


class Supervised(Trainable):
    """Backbone, colour and pre-scope head, and IC-SBP of ObPose, without a decoder."""

    observation_type = LabelledObservation
    center: Tensor

    def __init__(self, config: SupervisedConfig, *, backbone: Backbone, heads: Heads, attention: ICSBP):
        """Compose the parts."""
        super().__init__()
        self.config, self.backbone, self.heads, self.attention = config, backbone, heads, attention
        self.register_buffer("center", torch.tensor(config.model.workspace_center), persistent=False)

    @property
    def background_slot(self) -> int | None:
        """Label 0 if the background is a component."""
        return 0 if self.config.model.has_background else None

    def masks(self, observation: Observation, generator: torch.Generator | None) -> tuple[Embeddings, Masks]:
        """Compute embeddings and attention masks."""
        points, model = unproject(observation), self.config.model
        embeddings = embed(self.backbone, self.heads, observation, points, config=model, center=self.center)
        return embeddings, self.attention(embeddings, generator).masks

    def losses(
        self, observation: Observation, *, step: int, fraction: float = 0.0, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Compute the cross-entropy of masks and labels, with objects matched to slots, and the remaining scope."""
        if not isinstance(observation, LabelledObservation):
            raise TypeError(f"{type(self).__name__} learns from labels; expected a LabelledObservation.")
        encoded = select_input_views(observation, self.config.train.views, generator)
        embeddings, masks = self.masks(encoded, generator)
        log_masks = log_masks_at_pixels(masks, embeddings.valid, encoded, grid=self._grid(encoded))
        labels = rearrange(encoded.segmentation, "b f v h w -> b f (v h w)")
        valid = rearrange(encoded.valid, "b f v h w -> b f (v h w)")
        terms = {
            "cross_entropy": matched_cross_entropy(log_masks, labels.masked_fill(~valid, _IGNORED)),
            "scope": remaining_scope(masks.log_scope, embeddings.valid),
        }
        total = _CROSS_ENTROPY * terms["cross_entropy"] + _SCOPE * terms["scope"]
        return {"total": total, **{name: term.detach() for name, term in terms.items()}}

    @torch.no_grad()
    def segment(self, observation: Observation) -> Segmentation:
        """Label every pixel with the component of the largest mask."""
        embeddings, masks = self.masks(observation, None)
        owners = pixel_owners(masks, embeddings.valid, observation, grid=self._grid(observation))
        return Segmentation(labels=owners, attention=owners)

    def _grid(self, observation: Observation) -> tuple[int, int]:
        return self.backbone.grid_size(*observation.depth.shape[3:])


def build_supervised(config: SupervisedConfig) -> Supervised:
    """Build a model with fresh weights from PyTorch's global generator."""
    backbone = Backbone(config.model.backbone, scene_code=False)
    heads = Heads(config.model, features=False)
    return Supervised(config, backbone=backbone, heads=heads, attention=ICSBP(config.model))


_IGNORED = -1
"""Label of ignored pixels."""
_FLOOR = -12.0
"""Log-likelihood of an outlier, so that pixels far from the seed of their slot, of which a fresh model has many, do not
dominate the loss. [ours]"""


def matched_cross_entropy(
    log_masks: Float[Tensor, "batch frame component pixel"], labels: Int[Tensor, "batch frame pixel"]
) -> Float[Tensor, ""]:
    """Mean of -log(m + e^floor) over pixels, where m is the mask of the component matched to the pixel's object.

    Label 0 is component 0. The other labels of a clip are matched one to one to the slots over the whole clip, so that
    masks and objects overlap most (Kuhn 1955). Surplus objects and labels below 0 are ignored.
    """
    components = torch.stack([_matched(*clip) for clip in zip(log_masks.detach(), labels, strict=True)])
    chosen = log_masks.gather(2, components.clamp(min=0)[:, :, None])[:, :, 0]
    unlikely = torch.logaddexp(chosen, chosen.new_tensor(_FLOOR))
    return mean_over(-unlikely, (components >= 0).to(log_masks.dtype))


def _matched(
    log_masks: Float[Tensor, "frame component pixel"], labels: Int[Tensor, "frame pixel"]
) -> Int[Tensor, "frame pixel"]:
    """Match objects to slots, and give the component of each pixel of a clip."""
    names = labels.unique()
    objects = names[names > 0]
    components = torch.where(labels == 0, 0, _IGNORED)
    mine = (labels[None] == objects[:, None, None]).to(log_masks.dtype)
    overlap = torch.einsum("fsp,ofp->so", log_masks[:, 1:].exp(), mine)
    slots, matched = linear_sum_assignment(overlap.cpu().numpy(), maximize=True)
    for slot, place in zip(slots, matched, strict=True):
        components = torch.where(labels == objects[place], int(slot) + 1, components)
    return components
