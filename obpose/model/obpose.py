"""ObPose: from RGB-D clips to posed object fields and a background field (paper, sections Encoder and Decoder).

The paper's ablations and the other systems of its tables, except ObSuRF, are configurations of it
(`obpose.variants.VARIANTS`). `obpose.model.build` builds the parts.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import torch
import torch.nn.functional as F
from einops import rearrange, repeat
from jaxtyping import Float
from torch import Tensor

from obpose.config import Config
from obpose.geometry import all_rays, sample_rays, sample_rays_where, unproject
from obpose.model.attention.given import Labels, attended_as_labelled
from obpose.model.attention.heads import Heads
from obpose.model.attention.interface import Attended, Attention, not_largest
from obpose.model.attention.upsample import masks_at
from obpose.model.backbone import Backbone, plain_colours
from obpose.model.layers.latent import RecurrentLatent
from obpose.model.losses.attention import attention_loss, attention_warmup
from obpose.model.losses.objective import kl, observation_terms, remaining_scope, translation, weighted_terms
from obpose.model.losses.observation import colour_log_likelihood
from obpose.model.nerf.along import Decode, FieldsAlongRays, fields_along
from obpose.model.nerf.components import Background, Codes, Colours, Fields, decode, decode_background
from obpose.model.nerf.field import Field
from obpose.model.nerf.voxels import estimate_shape
from obpose.model.perception import Points, embed, pixel_owners, posterior_masks, select_input_views
from obpose.model.pose.crop import BoxSamples, gather_box
from obpose.model.pose.encoder import ObjectEncoder
from obpose.model.pose.location import Where, observed_center
from obpose.model.pose.orientation import observed_rotation
from obpose.trainable import Trainable
from obpose.types import (
    Boxes,
    ComponentRays,
    Decoded,
    Draw,
    Embeddings,
    Inference,
    Masks,
    Observation,
    RayPoints,
    Rays,
    SceneSegmentation,
)

SlotPoints = Float[Tensor, "batch frame slot 3"]
SlotRotations = Float[Tensor, "batch frame slot 3 3"]


class EmbeddedViews(NamedTuple):
    """Views that are encoded."""

    observation: Observation
    points: Points
    embeddings: Embeddings


class ObPose(Trainable):
    """Model of the paper, its ablations, and IC-SBP and slot attention over world-frame fields.

    Inference: backbone and heads (embeddings) - attention (masks) - `where` and orientation (boxes) - `what` and
    background latents. The decoder turns boxes and latents into fields, which the losses compare with the observation.
    """

    center: Tensor

    def __init__(
        self,
        config: Config,
        *,
        backbone: Backbone,
        heads: Heads,
        attention: Attention,
        where_encoder: ObjectEncoder | None,
        where: Where | None,
        what_encoder: ObjectEncoder | None,
        what: RecurrentLatent,
        background: RecurrentLatent | None,
        object_field: Field,
        background_field: Field | None,
    ):
        """Compose the parts.

        Args:
            config: Settings of all parts.
            backbone: Embeddings of points.
            heads: Inputs of the attention and of the encoders.
            attention: Masks, and with slot attention codes of the slots.
            where_encoder: Encoder of the unrotated boxes at the observed centres; None without pose conditioning.
            where: z_where and translation; None without pose conditioning.
            what_encoder: Encoder of the boxes; None if the attention gives codes.
            what: z_what.
            background: z_bg; None without a background component.
            object_field: Field that all objects share.
            background_field: Field of the background; None without a background component.
        """
        super().__init__()
        self.config = config
        self.backbone, self.heads, self.attention = backbone, heads, attention
        self.where_encoder, self.where, self.what_encoder, self.what = where_encoder, where, what_encoder, what
        self.background, self.object_field, self.background_field = background, object_field, background_field
        self.register_buffer("center", torch.tensor(config.model.workspace_center), persistent=False)

    @property
    def background_slot(self) -> int | None:
        """Label 0 if the background is a component; otherwise 0 marks only pixels without depth."""
        return 0 if self.config.model.has_background else None

    # Inference (paper, section 2.1)

    def infer(
        self, observation: Observation, *, draw: Draw = "mean", generator: torch.Generator | None = None
    ) -> Inference:
        """Masks, poses and latents of a clip. Attention follows the rules for training in training mode."""
        views = self._embed(observation)
        return self._encode(views, self._attend(views, generator), draw=draw, generator=generator)

    def _attend(self, views: EmbeddedViews, generator: torch.Generator | None) -> Attended:
        """Masks of the views that are encoded."""
        return self.attention(views.embeddings, generator)

    def _embed(self, observation: Observation) -> EmbeddedViews:
        points = unproject(observation)
        embeddings = embed(self.backbone, self.heads, observation, points, config=self.config.model, center=self.center)
        return EmbeddedViews(observation, points, embeddings)

    def _encode(
        self, views: EmbeddedViews, attended: Attended, *, draw: Draw = "mean", generator: torch.Generator | None = None
    ) -> Inference:
        """Poses and latents under given masks."""
        model, masks, embeddings = self.config.model, attended.masks, views.embeddings
        center, rotation = self._observed_pose(views, masks)
        upright = torch.eye(3, dtype=center.dtype, device=center.device).expand(*center.shape, 3)
        # Where: boxes {T_hat, R}; without pose conditioning every box is the workspace.
        where = None
        boxes = Boxes(self.center.expand_as(center), upright, model.workspace_size)
        if self.where is not None and self.where_encoder is not None:
            at_observed = Boxes(center, upright, model.pose.box_size)
            where = self.where(self.where_encoder(self._crop(embeddings, masks, at_observed)), draw, generator)
            # T_hat = T + T_max tanh(f_where(z_where)).
            boxes = Boxes(center + self.where.translation(where.z), rotation, model.pose.box_size)
        # What: shape and appearance in the frame of the box.
        codes = attended.slot_codes
        if codes is None:
            assert self.what_encoder is not None
            codes = self.what_encoder(self._crop(embeddings, masks, boxes))
        what = self.what(codes, draw, generator)
        background = None
        if self.background is not None:
            background = self.background(attended.background_code, draw, generator)
        return Inference(embeddings, masks, center, boxes, where, what, background)

    def _observed_pose(self, views: EmbeddedViews, masks: Masks) -> tuple[SlotPoints, SlotRotations]:
        """T and R of every slot in every frame, from its observed points."""
        center = self._observed_center(views, masks)
        # R: the minimum volume principle, on the pixels of each slot.
        if self.config.model.pose.conditioning != "full":
            return center, torch.eye(3, dtype=center.dtype, device=center.device).expand(*center.shape, 3)
        owners = self.pixel_owners(masks, views.embeddings, views.observation)
        return center, observed_rotation(views.points, owners, slots=center.shape[2])

    def _observed_center(self, views: EmbeddedViews, masks: Masks) -> SlotPoints:
        """T: the observed centre (paper, eq. 4)."""
        points, valid, exponent = (
            views.embeddings.points,
            views.embeddings.valid,
            self.config.model.attention.mask_exponent,
        )
        return observed_center(masks.log_masks, points, valid, exponent=exponent)

    def pixel_owners(self, masks: Masks, embeddings: Embeddings, observation: Observation) -> Tensor:
        """Component with the largest attention mask at each pixel; 0 for pixels without depth."""
        grid = self.backbone.grid_size(*observation.depth.shape[3:])
        return pixel_owners(masks, embeddings.valid, observation, grid=grid)

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

    # Decoding (paper, section 2.2)

    @property
    def fields(self) -> Fields:
        """Fields of objects and background, and their place in the world."""
        model = self.config.model
        return Fields(self.object_field, self.background_field, self.center, model.background_size, model.table)

    def decode(
        self,
        inference: Inference,
        points: RayPoints,
        directions: RayPoints,
        colours: Colours = "without",
        where_background: Background = "everywhere",
    ) -> Decoded:
        """Densities, and colours if requested, of all components at world points; boxes get no gradient."""
        boxes = None if self.config.model.pose.conditioning == "world" else fixed(inference.boxes)
        background = None if inference.background is None else inference.background.z
        codes = Codes(inference.masks.active, inference.what.z, background, boxes)
        return decode(self.fields, codes, points, directions, colours=colours, where_background=where_background)

    @torch.no_grad()
    def segment(self, observation: Observation, labels: Labels | None = None) -> SceneSegmentation:
        """Label every pixel, from posterior means: argmax of the composed density, 0 for pixels without depth.

        Args:
            observation: Clips.
            labels: Segmentation by another model, constant over time. Objects are then encoded under its masks, as
                many as it has, and it becomes the result.
        """
        views = self._embed(observation)
        if labels is not None:
            return self._segment_as_labelled(views, labels * observation.valid)
        attended = self.attention(views.embeddings, None)
        inference = self._encode(views, attended)
        # Masks become posteriors, given the decoded fields.
        for _ in range(self.config.model.attention.posterior_refinements):
            masks = self._posterior_masks(observation, inference)
            inference = self._encode(views, replace(attended, masks=masks))
        return SceneSegmentation(
            labels=self.labels_by_density(observation, inference),
            attention=self.pixel_owners(attended.masks, views.embeddings, observation),
            inference=inference,
        )

    def labels_by_density(self, observation: Observation, inference: Inference) -> Labels:
        """Argmax of the composed density at the observed surface; 0, the background, outside of all boxes."""
        rays = all_rays(observation)
        surface = rays.origin + rays.direction * rays.depth[..., None]
        logits = self.decode(inference, surface, rays.direction, where_background="in boxes").logits
        return (logits.max(dim=2).indices * rays.valid).reshape(observation.depth.shape)

    def _segment_as_labelled(self, views: EmbeddedViews, labels: Labels) -> SceneSegmentation:
        grid = self.backbone.grid_size(*labels.shape[3:])
        attended = attended_as_labelled(labels, views.embeddings, self.attention, grid=grid)
        return SceneSegmentation(labels=labels, attention=labels, inference=self._encode(views, attended))

    def _posterior_masks(self, observation: Observation, inference: Inference) -> Masks:
        """Posterior over components at each point of the grid, by density and colour of the fields there."""
        embeddings, views = inference.embeddings, observation.depth.shape[2]
        # Each point is seen along the ray from the camera of its view.
        frames, count = embeddings.points.shape[1:3]
        centers = observation.world_from_camera[..., :3, 3]
        cameras = repeat(centers, "b v c -> b f (v point) c", f=frames, point=count // views)
        found = self.decode(inference, embeddings.points, embeddings.points - cameras, "with", "in boxes")
        assert found.colours is not None
        # Likelihood of the observed colour, for all channels together.
        likelihood = colour_log_likelihood(found.colours, plain_colours(embeddings.rgb)).sum(dim=-1)
        return posterior_masks(inference.masks, found.logits, likelihood, embeddings.valid)

    # Training (paper, section 3)

    def losses(
        self, observation: Observation, *, step: int, fraction: float = 0.0, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Compute the loss terms and their weighted sum; without objects in the warm-up."""
        views = self._embed(select_input_views(observation, self.config.train.views, generator))
        terms_of = self._warmup_terms if step < self.config.train.warmup else self._terms
        return weighted_terms(terms_of(observation, views, generator), self.config.loss, fraction=fraction)

    def _terms(
        self, observation: Observation, views: EmbeddedViews, generator: torch.Generator | None
    ) -> dict[str, Tensor]:
        """Terms of L_obs, L_att and L_others; `views` are those of the observation that are encoded."""
        # Rays where objects are expected: by the pre-scope, or without one outside of the largest component.
        rays, embeddings = None, views.embeddings
        if embeddings.log_prescope is not None:
            rays = self._sample_rays(views, observation, embeddings.log_prescope[..., 1].exp(), generator)
        # Inference, with latents drawn from their posteriors.
        inference = self._encode(views, self._attend(views, generator), draw="sample", generator=generator)
        masks, active = inference.masks, inference.masks.active
        if rays is None:
            rays = self._sample_rays(views, observation, not_largest(masks.log_masks.detach()), generator)
        # L_obs.
        decode = partial(self.decode, inference)
        fields = fields_along(rays, decode, generator)
        terms = self._observation_terms(fields, views, observation, decode, generator)
        if inference.background is not None:
            terms["kl_background"] = kl(inference.background)
        terms |= self._mask_terms(masks, self._masks_at(masks.log_masks, rays, views), fields, embeddings)
        # L_others.
        terms["kl_what"] = kl(inference.what, active[:, None])
        if inference.where is not None:
            # T_shape on one random frame per clip, for speed; the authors take all frames.
            batch, frames = observation.depth.shape[:2]
            frame = torch.randint(frames, (batch,), generator=generator, device=observation.depth.device)
            box, z = fixed(inference.boxes), inference.what.z
            options = {"frame": frame, "resolution": self.config.model.voxels, "table": self.config.model.table_top}
            shape = estimate_shape(self.object_field, box, active, z, observation, generator=generator, **options)
            terms["translation"] = translation(inference.boxes.center, shape.center, shape.found, active)
            terms["kl_where"] = kl(inference.where, active[:, None])
        return terms

    def _mask_terms(
        self, masks: Masks, log_masks: ComponentRays, fields: FieldsAlongRays, embeddings: Embeddings
    ) -> dict[str, Tensor]:
        """Terms that the masks are learned by: L_att on the masks at the rays, and the remaining scope of L_others."""
        return {
            "attention": attention_loss(log_masks, fields, self.config.loss),
            "scope": remaining_scope(masks.log_scope, embeddings.valid),
        }

    def _warmup_terms(
        self, observation: Observation, views: EmbeddedViews, generator: torch.Generator | None
    ) -> dict[str, Tensor]:
        """Terms of the warm-up, in which the background has to explain everything."""
        assert self.background is not None
        rays = sample_rays(views.observation, self._rays_of(views, observation), generator)
        background = self.background(self.attention.background_code(views.embeddings, generator), "sample", generator)
        # L_obs.

        def decode(points: RayPoints, directions: RayPoints, colours: Colours) -> Decoded:
            return decode_background(self.fields, background.z, points, directions, colours=colours)

        fields = fields_along(rays, decode, generator)
        terms = self._observation_terms(fields, views, observation, decode, generator)
        terms["kl_background"] = kl(background)
        # L_att without objects.
        if views.embeddings.log_prescope is not None:
            log_prescope = self._masks_at(views.embeddings.log_prescope.mT, rays, views)
            terms["attention"] = attention_warmup(log_prescope, fields)
        return terms

    def _observation_terms(
        self,
        fields: FieldsAlongRays,
        views: EmbeddedViews,
        observation: Observation,
        decode: Decode,
        generator: torch.Generator | None,
    ) -> dict[str, Tensor]:
        """Terms of L_obs; if not all views are encoded, half of the rays and of the weight are of all views."""
        terms = observation_terms(fields, self.config.loss)
        if views.observation is observation:
            return terms
        rays = sample_rays(observation, self.config.train.rays - self._rays_of(views, observation), generator)
        others = observation_terms(fields_along(rays, decode, generator), self.config.loss)
        return {name: (term + others[name]) / 2 for name, term in terms.items()}

    def _rays_of(self, views: EmbeddedViews, observation: Observation) -> int:
        """Number of rays through encoded views."""
        rays = self.config.train.rays
        return rays if views.observation is observation else rays // 2

    @torch.no_grad()
    def _sample_rays(
        self,
        views: EmbeddedViews,
        observation: Observation,
        scope: Float[Tensor, "batch frame point"],
        generator: torch.Generator | None,
    ) -> Rays:
        """Draw rays, a share of them where the `scope` on the embedding grid expects objects."""
        encoded = views.observation
        count, height, width = encoded.depth.shape[2:]
        rows, columns = self.backbone.grid_size(height, width)
        # The scope at pixels.
        scope = rearrange(scope, "b f (v h w) -> (b f) v h w", v=count, h=rows, w=columns)
        interest = F.interpolate(scope, size=(height, width), mode="nearest")
        interest = rearrange(interest, "(b f) v h w -> b f v h w", b=len(encoded.depth))
        share = self.config.train.object_rays
        return sample_rays_where(encoded, self._rays_of(views, observation), interest, share=share, generator=generator)

    def _masks_at(self, log_masks: Tensor, rays: Rays, views: EmbeddedViews) -> Tensor:
        """Log masks of the grid at the pixels of rays."""
        count, height, width = views.observation.depth.shape[2:]
        grid = (count, *self.backbone.grid_size(height, width))
        return masks_at(log_masks, views.embeddings.valid, rays.index, grid=grid, size=(height, width))


def fixed(boxes: Boxes) -> Boxes:
    """Boxes without a gradient."""
    return Boxes(boxes.center.detach(), boxes.rotation, boxes.size)
