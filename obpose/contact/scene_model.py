"""ObPose with the masks of the contact model: masks, poses and fields of the objects of a clip.

The contact model segments the clip (`obpose.contact.model`), and ObPose encodes each of its objects (where, what,
minimum-volume pose, NeRF). Both are trained in the same steps, without labels: the contact model on pasted images, the
rest on clips in which connected components, followed over time, serve as objects.
"""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from obpose.contact.config import ContactConfig, ContactObPoseConfig
from obpose.contact.model import ContactModel
from obpose.contact.motion.boxes import boxes_over_time
from obpose.contact.pasting import ClipsWithPasted
from obpose.data.clips import ClipSource
from obpose.model.attention.given import Labels, attended_as_labelled
from obpose.model.attention.interface import Attended
from obpose.model.build import build_parts
from obpose.model.layers.numerics import log_sum_exp
from obpose.model.losses.observation import mean_over
from obpose.model.nerf.along import FieldsAlongRays
from obpose.model.nerf.compose import log_share
from obpose.model.obpose import EmbeddedViews, ObPose, SlotPoints, SlotRotations
from obpose.model.pose.orientation import standing_boxes
from obpose.types import (
    ComponentRays,
    ContactObservation,
    Embeddings,
    Masks,
    Observation,
    PastedObservation,
    RayValues,
    SceneSegmentation,
)

CONTACT = 0.25
"""Weight of the contact model's loss. It only matters to the common clipping of gradients."""
LEARNING_RATE = 3.0
"""Factor of the contact model's learning rate."""
LEAST_SHARE = -18.0
"""Least logarithm of a share: rays whose object has no density in its box do not pull."""


class ContactObPose(ObPose):
    """ObPose whose masks come from the contact model."""

    observation_type = ContactObservation

    def __init__(self, config: ContactObPoseConfig, *, contact: ContactModel, **parts: Any):
        """Compose the contact model and the parts of ObPose (`obpose.model.build.build_parts`)."""
        super().__init__(config, **parts)
        self.contact = contact

    def training_source(self, source: ClipSource) -> ClipSource:
        """Add pseudo-objects and pasted images to clips; labels of the source are not read."""
        scale = self.contact.config.model.image_scale
        return ClipsWithPasted(source, self.contact.pasted_clips(source), seed=self.config.train.seed, scale=scale)

    def check_source(self, source: ClipSource) -> None:
        """Check that the clips show objects, as the contact model does."""
        self.contact.check_source(source)

    def next_source(self, source: ClipSource, fraction: float) -> ClipSource:
        """Divide the pseudo-objects as the contact model does."""
        return self.contact.next_source(source, fraction)

    def training_state(self) -> dict[str, Tensor]:
        """Give the state of the contact model."""
        return self.contact.training_state()

    def restore_training_state(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `training_state` gave.

        Raises:
            UsageError: it does not fit the model.
        """
        self.contact.restore_training_state(state)

    def parameter_groups(self) -> list[tuple[list[nn.Parameter], float]]:
        """Parameters of ObPose, then of the contact model, which learns faster."""
        contact = {*self.contact.parameters()}
        others = [parameter for parameter in self.parameters() if parameter not in contact]
        return [(others, 1.0), ([*self.contact.parameters()], LEARNING_RATE)]

    def losses(
        self, observation: Observation, *, step: int, fraction: float = 0.0, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Compute the terms of ObPose on the clips, and those of the contact model on the pasted images."""
        assert isinstance(observation, ContactObservation)
        parts = [
            super().losses(observation.clips, step=step, fraction=fraction, generator=generator),
            self.contact.losses(observation.pasted, step=step, fraction=fraction, generator=generator),
        ]
        total = parts[0].pop("total") + CONTACT * parts[1].pop("total")
        return {"total": total, **parts[0], **parts[1]}

    def _attend(self, views: EmbeddedViews, generator: torch.Generator | None) -> Attended:
        """Masks of the pseudo-objects in training."""
        observation = views.observation
        if not isinstance(observation, PastedObservation):
            return super()._attend(views, generator)
        grid = self.backbone.grid_size(*observation.depth.shape[3:])
        return attended_as_labelled(observation.pseudo_labels, views.embeddings, self.attention, grid=grid)

    def _observed_pose(self, views: EmbeddedViews, masks: Masks) -> tuple[SlotPoints, SlotRotations]:
        """T and R of every slot from the smallest box, which for a standing object reaches down to the table.

        At evaluation the box is that of all points that the clip shows of the object, unless a translation was learned:
        that is relative to the boxes of training.
        """
        if self.config.model.pose.conditioning != "full":
            return super()._observed_pose(views, masks)
        center = self._observed_center(views, masks)
        owners = self.pixel_owners(masks, views.embeddings, views.observation)
        # Nothing below `model.table`, a millimetre above the table, belongs to an object; boxes end there, too.
        table = self.config.model.table or 0.0
        middle, rotation, found = standing_boxes(views.points, owners, slots=center.shape[2], table=table)
        boxes = torch.where(found[..., None], middle, center), rotation
        if self.training or self.config.model.pose.max_translation:
            return boxes
        return boxes_over_time(views.points, views.observation.rgb, owners, boxes, table=table)

    def _mask_terms(
        self, masks: Masks, log_masks: ComponentRays, fields: FieldsAlongRays, embeddings: Embeddings
    ) -> dict[str, Tensor]:
        """Term by which fields learn from the masks."""
        return {"assignment": assignment_loss(log_masks, fields.surface.logits, fields.rays.weight)}

    @torch.no_grad()
    def segment(self, observation: Observation, labels: Labels | None = None) -> SceneSegmentation:
        """Label every pixel by the contact model, and encode the objects.

        `attention` holds the labels by the argmax of the fields' composed density.

        Args:
            observation: Clips.
            labels: Segmentation by another model, instead of the contact model's; constant over time.
        """
        given = self.contact.label_objects(observation) if labels is None else labels
        found = super().segment(observation, given)
        return SceneSegmentation(found.labels, self.labels_by_density(observation, found.inference), found.inference)


def assignment_loss(log_masks: ComponentRays, logits: ComponentRays, weight: RayValues) -> Float[Tensor, ""]:
    """Cross-entropy between given masks and the shares of the density at the surface: -log sum_k m_k sigma_hat_k.

    This is the second sum of the mixture loss (paper, eq. 10), with the gradient to the fields instead of
    the masks.
    """
    shares = log_sum_exp(log_masks + log_share(logits), dim=2)
    return mean_over(-shares.clamp(min=LEAST_SHARE), weight)


def build_contact_obpose(config: ContactObPoseConfig) -> ContactObPose:
    """Build a model with fresh weights from PyTorch's global generator."""
    contact = ContactModel(ContactConfig(model=config.contact, train=config.train))
    return ContactObPose(config, contact=contact, **build_parts(config))
