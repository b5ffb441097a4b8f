"""What ObPose infers from a clip: masks, poses and latents (paper, section Encoder)."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.config import Config
from obpose.geometry import unproject
from obpose.model.attention.slot import SlotAttention
from obpose.model.attention.summary import mean_under
from obpose.model.background import BackgroundLatent
from obpose.model.perception import Perception, Points, Prescope
from obpose.model.pose.crop import BoxSamples, gather_box
from obpose.model.pose.encoder import ObjectEncoder
from obpose.model.pose.location import observed_center
from obpose.model.pose.orientation import observed_rotation
from obpose.model.pose.what import What
from obpose.model.pose.where import Where
from obpose.types import Boxes, Draw, Embeddings, Inference, Latent, Masks, Observation


class Codes(NamedTuple):
    """What the latents of objects and background are read from."""

    masks: Masks
    observed_center: Float[Tensor, "batch frame slot 3"]
    boxes: Boxes
    where: Latent | None
    objects: Float[Tensor, "batch frame slot code"]
    background: Float[Tensor, "batch frame scene"] | None


class SceneEncoder(Perception):
    """Encoders of objects and background over the masks, or over the slots of slot attention."""

    def __init__(self, config: Config):
        super().__init__(config)
        model, latent = config.model, config.model.latent
        means = self.feature_size if latent.means == "given" else 0
        self.where = self.what_encoder = self.background = None
        if model.pose.conditioning in ("location", "full"):
            self.where_encoder = ObjectEncoder(self.feature_size, latent)
            self.where = Where(self.where_encoder.size, latent, model.pose, model.weights)
        if isinstance(self.attention, SlotAttention):
            code = scene = model.slot_attention.width + (means and means + 3)
        else:
            code, scene = self.feature_size + 3, self.backbone.scene.size
            if latent.summary == "points":
                self.what_encoder = ObjectEncoder(self.feature_size, latent)
                code = self.what_encoder.size
        self.what = What(code, latent, model.weights)
        if model.background == "component":
            self.background = BackgroundLatent(scene, latent, model.weights)

    def infer(
        self, observation: Observation, *, draw: Draw = "mean", generator: torch.Generator | None = None
    ) -> Inference:
        """Masks, poses and latents of a clip. Seeds and idle slots follow the rules for training in training mode."""
        points = unproject(observation)
        return self.infer_from(observation, points, *self.embed(observation, points), draw, generator)

    def infer_from(
        self,
        observation: Observation,
        points: Points,
        embeddings: Embeddings,
        log_prescope: Prescope | None,
        draw: Draw,
        generator: torch.Generator | None,
    ) -> Inference:
        """The same from embeddings."""
        if isinstance(self.attention, SlotAttention):
            codes = self._codes_of_slots(embeddings, generator)
        else:
            masks = self.attend(embeddings, log_prescope, generator)
            codes = self._codes_of_masks(observation, points, embeddings, masks, draw, generator)
        return self._latents(embeddings, codes, draw, generator)

    def infer_under(self, observation: Observation, embeddings: Embeddings, masks: Masks) -> Inference:
        """Poses and posterior means under given masks."""
        codes = self._codes_of_masks(observation, unproject(observation), embeddings, masks, "mean", None)
        return self._latents(embeddings, codes, "mean", None)

    def _latents(
        self, embeddings: Embeddings, codes: Codes, draw: Draw, generator: torch.Generator | None
    ) -> Inference:
        what = self.what(codes.objects, draw, generator)
        background = None
        if self.background is not None and codes.background is not None:
            background = self.background(codes.background, draw, generator)
        return Inference(
            embeddings=embeddings,
            masks=codes.masks,
            observed_center=codes.observed_center,
            boxes=codes.boxes,
            where=codes.where,
            what=what,
            background=background,
        )

    def infer_background(self, embeddings: Embeddings, draw: Draw, generator: torch.Generator | None) -> Latent | None:
        """The background's latent alone."""
        if self.background is None:
            return None
        code = embeddings.scene
        if isinstance(self.attention, SlotAttention):
            code = self._codes_of_slots(embeddings, generator).background
        return self.background(code, draw, generator)

    def _codes_of_slots(self, embeddings: Embeddings, generator: torch.Generator | None) -> Codes:
        masks, objects, background = self.attend_slots(embeddings, generator)
        if self.config.model.latent.means == "given":
            values = torch.cat([embeddings.features, self.in_workspace(embeddings)], dim=-1)
            seen = mean_under(masks.log_masks, embeddings.valid, values)
            objects = torch.cat([objects, seen[:, :, 1:]], dim=-1)
            if background is not None:
                background = torch.cat([background, seen[:, :, 0]], dim=-1)
        center = self._observed_center(embeddings, masks)
        return Codes(masks, center, self._workspace(center), None, objects, background)

    def _codes_of_masks(
        self,
        observation: Observation,
        points: Points,
        embeddings: Embeddings,
        masks: Masks,
        draw: Draw,
        generator: torch.Generator | None,
    ) -> Codes:
        center = self._observed_center(embeddings, masks)
        boxes, where = self._locate(observation, points, embeddings, masks, center, draw, generator)
        if self.what_encoder is not None:
            objects = self.what_encoder(self._crop(embeddings, masks, boxes))
        else:
            values = torch.cat([embeddings.features, self.in_workspace(embeddings)], dim=-1)
            objects = mean_under(masks.log_masks[:, :, 1:], embeddings.valid, values)
        return Codes(masks, center, boxes, where, objects, embeddings.scene)

    def _observed_center(self, embeddings: Embeddings, masks: Masks) -> Float[Tensor, "batch frame slot 3"]:
        return observed_center(
            masks.log_masks,
            embeddings.points,
            embeddings.valid,
            min_points=self.config.model.pose.min_points,
            power=self.config.model.attention.mask_power,
        )

    def _locate(
        self,
        observation: Observation,
        points: Points,
        embeddings: Embeddings,
        masks: Masks,
        center: Float[Tensor, "batch frame slot 3"],
        draw: Draw,
        generator: torch.Generator | None,
    ) -> tuple[Boxes, Latent | None]:
        """The objects' boxes, and z_where; without conditioning every box is the workspace."""
        if self.where is None:
            return self._workspace(center), None
        upright, pose = _upright(center), self.config.model.pose
        seen = self._crop(embeddings, masks, Boxes(center, upright, pose.box_size))
        where = self.where(self.where_encoder(seen), draw, generator)
        turned = upright
        if pose.conditioning == "full":
            owners = self.pixel_owners(masks, embeddings.valid, observation)
            turned = observed_rotation(points, owners, slots=self.slots, pose=pose)
        return Boxes(center + self.where.translation(where.z), turned, pose.box_size), where

    def _workspace(self, center: Float[Tensor, "batch frame slot 3"]) -> Boxes:
        """The workspace as the box of every slot."""
        return Boxes(self.center.expand_as(center), _upright(center), self.config.model.workspace_size)

    def _crop(self, embeddings: Embeddings, masks: Masks, boxes: Boxes) -> BoxSamples:
        return gather_box(
            embeddings.points,
            embeddings.valid,
            embeddings.features,
            masks.log_masks[:, :, 1:],
            fixed(boxes),
            samples=self.config.model.latent.samples,
            whose=self.config.model.pose.points,
        )


def _upright(center: Float[Tensor, "batch frame slot 3"]) -> Float[Tensor, "batch frame slot 3 3"]:
    return torch.eye(3, dtype=center.dtype, device=center.device).expand(*center.shape, 3)


def fixed(boxes: Boxes) -> Boxes:
    """Boxes without a gradient."""
    return Boxes(boxes.center.detach(), boxes.rotation, boxes.size)
