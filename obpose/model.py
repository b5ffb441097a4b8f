"""ObPose: from RGB-D clips to posed object fields and a background field (paper, sections Encoder and Decoder)."""

from typing import Any

import torch
import torch.nn.functional as F
from einops import rearrange, repeat
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.attention.heads import Heads
from obpose.attention.icsbp import ICSBP
from obpose.backbone import Backbone
from obpose.background import BackgroundLatent
from obpose.config import Config
from obpose.geometry import all_rays, sample_rays, sample_rays_where, unproject
from obpose.losses.objective import Evidence, loss_terms
from obpose.nerf.components import Colours, decode, decode_background
from obpose.nerf.field import Field
from obpose.nerf.points import air_points, surface_points
from obpose.nerf.voxels import estimate_shape
from obpose.pose.crop import BoxSamples, gather_box
from obpose.pose.encoder import ObjectEncoder
from obpose.pose.location import observed_center
from obpose.pose.minimum_volume import orient
from obpose.pose.what import What
from obpose.pose.where import Where
from obpose.trainable import Trainable
from obpose.types import Boxes, Decoded, Draw, Embeddings, Inference, Latent, Masks, Observation, Rays, Segmentation

_ORIENTATION_POINTS = 256
"""So many surface points of an object, spread over its pixels, its orientation is found from."""

Points = Float[Tensor, "batch frame ray 3"]


class ObPose(Trainable):
    """The model of the paper and its ablations."""

    center: Tensor

    def __init__(self, config: Config):
        """Build it with fresh weights, drawn from PyTorch's global generator."""
        super().__init__()
        self.config = config
        model, latent = config.model, config.model.latent
        self.backbone = Backbone(model.backbone)
        self.heads = Heads(model.backbone, model.attention)
        self.attention = ICSBP(model.attention, slots=model.slots)
        feature = model.backbone.feature + 3
        if model.pose.conditioning != "none":
            self.where_encoder = ObjectEncoder(feature, latent.encoder)
            self.where = Where(self.where_encoder.size, latent, model.pose)
        else:
            self.where = None
        self.what_encoder = ObjectEncoder(feature, latent.encoder)
        self.what = What(self.what_encoder.size, latent)
        self.background = BackgroundLatent(self.backbone.scene.size, latent)
        self.object_field = Field(model.object_field, latent.what)
        self.background_field = Field(model.background_field, latent.background)
        self.register_buffer("center", torch.tensor(model.workspace_center), persistent=False)

    def losses(
        self, observation: Observation, *, step: int, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Loss terms and their weighted sum (paper, section Training); in the warm-up without any objects."""
        if step < self.config.train.warmup:
            evidence = self._observe_background(observation, generator)
        else:
            evidence = self._observe(observation, generator)
        return loss_terms(evidence, self.config.loss)

    @torch.no_grad()
    def segment(self, observation: Observation) -> Segmentation:
        """Labels of every pixel, from posterior means."""
        inference = self.infer(observation)
        size = observation.depth.shape
        rays = all_rays(observation)
        logits = self.decode(inference, rays.origin + rays.direction * rays.depth[..., None], rays.direction).logits
        return Segmentation(
            labels=(logits.argmax(dim=2) * rays.valid).reshape(size),
            attention=self.pixel_owners(inference.masks, observation),
            inference=inference,
        )

    def infer(
        self, observation: Observation, *, draw: Draw = "mean", generator: torch.Generator | None = None
    ) -> Inference:
        """Masks, poses and latents of a clip. Seeds and idle slots follow the rules for training in training mode."""
        points = unproject(observation)
        return self._infer(observation, points, *self.embed(observation, points), draw, generator)

    def _infer(
        self,
        observation: Observation,
        points: Float[Tensor, "batch frame view height width 3"],
        embeddings: Embeddings,
        log_prescope: Float[Tensor, "batch frame point 2"],
        draw: Draw,
        generator: torch.Generator | None,
    ) -> Inference:
        masks = self._attend(embeddings, log_prescope, generator)
        center = self._observed_center(embeddings, masks)
        boxes, where = self._locate(observation, points, embeddings, masks, center, draw, generator)
        return Inference(
            embeddings=embeddings,
            masks=masks,
            observed_center=center,
            boxes=boxes,
            where=where,
            what=self.what(self.what_encoder(self._crop(embeddings, masks, boxes)), draw, generator),
            background=self.background(embeddings.scene, draw, generator),
        )

    def embed(
        self, observation: Observation, points: Float[Tensor, "batch frame view height width 3"]
    ) -> tuple[Embeddings, Float[Tensor, "batch frame point 2"]]:
        """Backbone and heads; the second value is the log of the pre-scope: background, s_0."""
        cells = {"b": points.shape[0], "f": points.shape[1]}
        out = self.backbone(
            rearrange(points, "b f v h w c -> (b f v) h w c"),
            rearrange(observation.rgb, "b f v h w c -> (b f v) h w c"),
            rearrange(observation.valid, "b f v h w -> (b f v) h w"),
            spacing=self.config.model.spacing,
            center=self.center,
            workspace_radius=self.config.model.workspace_size / 2,
        )
        grid = rearrange(out.points, "(b f v) h w c -> b f (v h w) c", **cells)
        valid = rearrange(out.valid, "(b f v) h w -> b f (v h w)", **cells)
        embedding = rearrange(out.embedding, "(b f v) h w c -> b f (v h w) c", **cells)
        rgb = rearrange(out.rgb, "(b f v) h w c -> b f (v h w) c", **cells)
        colour, features, log_prescope = self.heads(grid, valid, rgb, embedding, center=self.center)
        # The observed colours stand beside zeta_f, so that the latents need not wait for the backbone.
        features = torch.cat([features, rgb], dim=-1)
        scene = rearrange(out.scene, "(b f v) c -> b f v c", **cells).mean(dim=2)
        return Embeddings(grid, valid, colour, features, scene), log_prescope

    def decode(self, inference: Inference, points: Points, directions: Points, colours: Colours = "without") -> Decoded:
        """Densities, and colours if asked for, of all components at world points; boxes are held fixed."""
        return decode(
            self.object_field,
            self.background_field,
            _fixed(inference.boxes),
            inference.masks.active,
            inference.what.z,
            inference.background.z,
            points,
            directions,
            workspace_center=self.center,
            workspace_size=self.config.model.background_size,
            colours=colours,
            floor=self.config.model.table,
        )

    @torch.no_grad()
    def pixel_owners(self, masks: Masks, observation: Observation) -> Int[Tensor, "batch frame view height width"]:
        """The component with the largest attention mask at each pixel, upsampled; background where nothing was seen."""
        views, height, width = observation.depth.shape[2:]
        rows, columns = self.backbone.grid_size(height, width)
        cells = rearrange(masks.log_masks.exp(), "b f c (v h w) -> (b f v) c h w", v=views, h=rows, w=columns)
        upsampled = F.interpolate(cells, size=(height, width), mode="bilinear", align_corners=False)
        owners = rearrange(upsampled.argmax(dim=1), "(b f v) h w -> b f v h w", b=len(observation.depth), v=views)
        return owners * observation.valid

    def _attend(self, embeddings: Embeddings, log_prescope: Tensor, generator: torch.Generator | None) -> Masks:
        config = self.config.model.attention
        return self.attention(
            embeddings.colour,
            embeddings.valid,
            log_prescope,
            slots=self.config.model.slots,
            seeds=config.seeds if self.training else config.evaluation_seeds,
            idle=config.idle_in_training if self.training else "threshold",
            division="sticks" if self.training else config.evaluation_division,
            generator=generator,
        )

    def _observed_center(self, embeddings: Embeddings, masks: Masks) -> Float[Tensor, "batch frame slot 3"]:
        return observed_center(
            masks.log_masks, embeddings.points, embeddings.valid, min_points=self.config.model.pose.min_points
        )

    def _locate(
        self,
        observation: Observation,
        points: Float[Tensor, "batch frame view height width 3"],
        embeddings: Embeddings,
        masks: Masks,
        center: Float[Tensor, "batch frame slot 3"],
        draw: Draw,
        generator: torch.Generator | None,
    ) -> tuple[Boxes, Latent | None]:
        """The objects' boxes, and z_where; without conditioning every box is the workspace."""
        upright = torch.eye(3, dtype=center.dtype, device=center.device).expand(*center.shape, 3)
        if self.where is None:
            everywhere = self.center.expand_as(center)
            return Boxes(everywhere, upright, self.config.model.workspace_size), None
        size = self.config.model.pose.box_size
        seen = self._crop(embeddings, masks, Boxes(center, upright, size))
        where = self.where(self.where_encoder(seen), draw, generator)
        turned = upright
        if self.config.model.pose.conditioning == "full":
            turned = self._orient(observation, points, masks)
        return Boxes(center + self.where.translation(where.z), turned, size), where

    @torch.no_grad()
    def _orient(
        self, observation: Observation, points: Float[Tensor, "batch frame view height width 3"], masks: Masks
    ) -> Float[Tensor, "batch frame slot 3 3"]:
        """Orientation of the observed surface points whose largest mask is the slot's.

        Deviation: those of the image's pixels, which are finer than the embedding grid's that the paper takes.
        """
        owners = rearrange(self.pixel_owners(masks, observation), "b f v h w -> b f (v h w)")
        chosen, valid = _some_of_each(owners, self.config.model.slots, _ORIENTATION_POINTS)
        flat = rearrange(points, "b f v h w c -> b f 1 (v h w) c").expand(-1, -1, self.config.model.slots, -1, -1)
        pose = self.config.model.pose
        return orient(
            flat.gather(-2, repeat(chosen, "b f s n -> b f s n 3")),
            valid,
            grid_level=pose.grid_level,
            refinements=pose.refinements,
            tolerance=pose.tolerance,
            min_points=pose.min_pixels,
        )

    def _crop(self, embeddings: Embeddings, masks: Masks, boxes: Boxes) -> BoxSamples:
        return gather_box(
            embeddings.points,
            embeddings.valid,
            embeddings.features,
            masks.log_masks[:, :, 1:],
            _fixed(boxes),
            samples=self.config.model.latent.samples,
        )

    def _observe(self, observation: Observation, generator: torch.Generator | None) -> Evidence:
        """Everything that the losses compare, along some rays."""
        points = unproject(observation)
        embeddings, log_prescope = self.embed(observation, points)
        rays = self._sample_rays(observation, log_prescope, generator)
        inference = self._infer(observation, points, embeddings, log_prescope, "sample", generator)
        loss = self.config.loss
        surface = surface_points(rays, loss.jitter, generator)
        air, inverse_rho = air_points(rays, loss.near_share, generator)
        shape = None
        if self.where is not None:
            shape = self._estimate_shape(observation, inference, generator)
        return Evidence(
            rays=rays,
            surface=self.decode(inference, surface, rays.direction, "with"),
            air=self.decode(inference, air, rays.direction),
            inverse_rho=inverse_rho,
            background=inference.background,
            embeddings=embeddings,
            log_prescope=log_prescope,
            **self._sizes(observation),
            inference=inference,
            shape=shape,
        )

    @torch.no_grad()
    def _sample_rays(
        self,
        observation: Observation,
        log_prescope: Float[Tensor, "batch frame point 2"],
        generator: torch.Generator | None,
    ) -> Rays:
        """More of them where objects are expected."""
        train, (views, height, width) = self.config.train, observation.depth.shape[2:]
        rows, columns = self.backbone.grid_size(height, width)
        scope = rearrange(log_prescope[..., 1].exp(), "b f (v h w) -> (b f) v h w", v=views, h=rows, w=columns)
        interest = F.interpolate(scope, size=(height, width), mode="nearest")
        interest = rearrange(interest, "(b f) v h w -> b f v h w", b=len(observation.depth))
        return sample_rays_where(observation, train.rays, interest, share=train.object_rays, generator=generator)

    def _observe_background(self, observation: Observation, generator: torch.Generator | None) -> Evidence:
        """The same where the background has to explain everything."""
        rays = sample_rays(observation, self.config.train.rays, generator)
        embeddings, log_prescope = self.embed(observation, unproject(observation))
        background = self.background(embeddings.scene, "sample", generator)
        loss = self.config.loss
        surface = surface_points(rays, loss.jitter, generator)
        air, inverse_rho = air_points(rays, loss.near_share, generator)
        return Evidence(
            rays=rays,
            surface=self._decode_background(background, surface, rays.direction, "with"),
            air=self._decode_background(background, air, rays.direction, "without"),
            inverse_rho=inverse_rho,
            background=background,
            embeddings=embeddings,
            log_prescope=log_prescope,
            **self._sizes(observation),
        )

    def _sizes(self, observation: Observation) -> dict[str, Any]:
        """Of the embedding grid and of the images."""
        views, height, width = observation.depth.shape[2:]
        return {"grid": (views, *self.backbone.grid_size(height, width)), "size": (height, width)}

    def _decode_background(self, background: Latent, points: Points, directions: Points, colours: Colours) -> Decoded:
        return decode_background(
            self.background_field,
            background.z,
            points,
            directions,
            workspace_center=self.center,
            workspace_size=self.config.model.background_size,
            colours=colours,
        )

    def _estimate_shape(self, observation: Observation, inference: Inference, generator: torch.Generator | None):
        """T_shape on one frame of each clip, drawn at random; the authors take all."""
        batch, frames = observation.depth.shape[:2]
        device = observation.depth.device
        model = self.config.model
        return estimate_shape(
            self.object_field,
            _fixed(inference.boxes),
            inference.masks.active,
            inference.what.z,
            observation,
            resolution=model.voxels,
            threshold=model.voxel_threshold,
            floor=model.floor,
            frame=torch.randint(frames, (batch,), generator=generator, device=device),
            generator=generator,
        )


def _fixed(boxes: Boxes) -> Boxes:
    return Boxes(boxes.center.detach(), boxes.rotation, boxes.size)


def _some_of_each(
    owners: Int[Tensor, "batch frame pixel"], slots: int, count: int
) -> tuple[Int[Tensor, "batch frame slot point"], Bool[Tensor, "batch frame slot point"]]:
    """At most `count` pixels of each slot, spread evenly over them in raster order, and which of them there are."""
    mine = owners[:, :, None] == torch.arange(1, slots + 1, device=owners.device)[:, None]
    rank = mine.cumsum(dim=-1) - 1
    total = mine.sum(dim=-1, keepdim=True)
    # Of `total` pixels those are kept at which the running share of `count` passes a whole number.
    kept = mine & ((rank + 1) * count // total.clamp(min=count) > rank * count // total.clamp(min=count))
    best = kept.to(torch.uint8).topk(min(count, kept.shape[-1]), dim=-1, sorted=False)
    return best.indices, best.values.bool()
