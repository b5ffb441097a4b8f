"""ObPose: from RGB-D clips to posed object fields and a background field (paper, sections Encoder and Decoder).

The paper's ablations and the other systems of its tables but one are values of it (`obpose.variants.VARIANTS`).
"""

from functools import partial
from typing import Any

import torch
import torch.nn.functional as F
from einops import rearrange, repeat
from jaxtyping import Float
from torch import Tensor

from obpose.config import Config
from obpose.geometry import all_rays, sample_rays, sample_rays_where, unproject
from obpose.model.attention.posterior import posterior_masks
from obpose.model.attention.summary import not_largest
from obpose.model.backbone import plain_colours
from obpose.model.encoder import SceneEncoder, fixed
from obpose.model.losses.objective import Evidence, loss_terms
from obpose.model.losses.observation import log_likelihood
from obpose.model.nerf.along import Decode, FieldsAlongRays, fields_along
from obpose.model.nerf.components import Background, Colours, decode, decode_background
from obpose.model.nerf.field import Field
from obpose.model.nerf.voxels import estimate_shape
from obpose.model.nerf.world import decode_world
from obpose.types import Decoded, Inference, Latent, Masks, Observation, Rays, SceneSegmentation, Shape

Points = Float[Tensor, "batch frame ray 3"]


class ObPose(SceneEncoder):
    """The model of the paper, its ablations, and IC-SBP and slot attention over world-frame fields."""

    def __init__(self, config: Config):
        """Build it with fresh weights, drawn from PyTorch's global generator."""
        super().__init__(config)
        model, latent = config.model, config.model.latent
        self.object_field = Field(model.object_field, latent.what, model.weights)
        self.background_field = None
        if model.background == "component":
            self.background_field = Field(model.background_field, latent.background, model.weights)

    def losses(
        self, observation: Observation, *, step: int, fraction: float = 0.0, generator: torch.Generator | None = None
    ) -> dict[str, Tensor]:
        """Loss terms and their weighted sum (paper, section Training); in the warm-up without any objects."""
        if step < self.config.train.warmup:
            evidence = self._observe_background(observation, generator)
        else:
            evidence = self._observe(observation, generator)
        return loss_terms(evidence, self.config.loss, fraction=fraction)

    @torch.no_grad()
    def segment(self, observation: Observation) -> SceneSegmentation:
        """Labels of every pixel, from posterior means: argmax of the composed density, 0 where there is no depth."""
        first = inference = self.infer(observation)
        for _ in range(self.config.model.attention.evaluation_rounds):
            masks = self._posterior_masks(observation, inference)
            inference = self.infer_under(observation, inference.embeddings, masks)
        size = observation.depth.shape
        rays = all_rays(observation)
        points = rays.origin + rays.direction * rays.depth[..., None]
        logits = self.decode(inference, points, rays.direction, where_background="in boxes").logits
        return SceneSegmentation(
            labels=(logits.argmax(dim=2) * rays.valid).reshape(size),
            attention=self.pixel_owners(first.masks, first.embeddings.valid, observation),
            inference=inference,
        )

    def _posterior_masks(self, observation: Observation, inference: Inference) -> Masks:
        """Which component each point of the grid is of, by density and colour of the fields there."""
        embeddings, loss = inference.embeddings, self.config.loss
        views = observation.depth.shape[2]
        cameras = repeat(
            observation.world_from_camera[..., :3, 3],
            "b v c -> b f (v point) c",
            f=embeddings.points.shape[1],
            point=embeddings.points.shape[2] // views,
        )
        seen = self.decode(inference, embeddings.points, embeddings.points - cameras, "with", "in boxes")
        assert seen.colours is not None
        likelihood = log_likelihood(
            seen.colours, plain_colours(embeddings.rgb), std=loss.colour_std, likelihood="joint"
        )
        return posterior_masks(inference.masks, seen.logits, likelihood[..., 0], embeddings.valid)

    def decode(
        self,
        inference: Inference,
        points: Points,
        directions: Points,
        colours: Colours = "without",
        where_background: Background = "everywhere",
    ) -> Decoded:
        """Densities, and colours if asked for, of all components at world points.

        Boxes are held fixed, they take no gradient. Where the order of the components is all that counts, the
        background's field is wanted `in boxes` only.
        """
        active, what = inference.masks.active, inference.what.z
        background = None if inference.background is None else inference.background.z
        options = self._world | {"colours": colours, "floor": self.config.model.table}
        fields = self.object_field, self.background_field
        if self.config.model.pose.conditioning == "world":
            return decode_world(*fields, active, what, background, points, directions, **options)
        options |= {"where_background": where_background}
        return decode(*fields, fixed(inference.boxes), active, what, background, points, directions, **options)

    @property
    def _world(self) -> dict[str, Any]:
        return {"workspace_center": self.center, "workspace_size": self.config.model.background_size}

    def _observe(self, observation: Observation, generator: torch.Generator | None) -> Evidence:
        """Everything that the losses compare, along some rays."""
        seen = self.seen(observation, generator)
        points = unproject(seen)
        embeddings, log_prescope = self.embed(seen, points)
        count = self._rays_of(seen, observation)
        if log_prescope is not None:
            rays = self._sample_rays(seen, log_prescope[..., 1].exp(), count, generator)
            inference = self.infer_from(seen, points, embeddings, log_prescope, "sample", generator)
        else:
            inference = self.infer_from(seen, points, embeddings, log_prescope, "sample", generator)
            rays = self._sample_rays(seen, not_largest(inference.masks.log_masks.detach()), count, generator)
        decode = partial(self.decode, inference)
        return Evidence(
            fields=fields_along(rays, decode, self.config.loss, generator),
            beyond=self._beyond(seen, observation, decode, generator),
            background=inference.background,
            embeddings=embeddings,
            log_prescope=log_prescope,
            **self._sizes(seen),
            inference=inference,
            shape=None if self.where is None else self._estimate_shape(observation, inference, generator),
        )

    @torch.no_grad()
    def _sample_rays(
        self,
        observation: Observation,
        scope: Float[Tensor, "batch frame point"],
        count: int,
        generator: torch.Generator | None,
    ) -> Rays:
        """More of them where objects are expected, which `scope` says of the embedding grid."""
        views, height, width = observation.depth.shape[2:]
        rows, columns = self.backbone.grid_size(height, width)
        scope = rearrange(scope, "b f (v h w) -> (b f) v h w", v=views, h=rows, w=columns)
        interest = F.interpolate(scope, size=(height, width), mode="nearest")
        interest = rearrange(interest, "(b f) v h w -> b f v h w", b=len(observation.depth))
        share = self.config.train.object_rays
        return sample_rays_where(observation, count, interest, share=share, generator=generator)

    def _observe_background(self, observation: Observation, generator: torch.Generator | None) -> Evidence:
        """The same where the background has to explain everything."""
        seen = self.seen(observation, generator)
        rays = sample_rays(seen, self._rays_of(seen, observation), generator)
        embeddings, log_prescope = self.embed(seen, unproject(seen))
        background = self.infer_background(embeddings, "sample", generator)
        assert background is not None
        decode = partial(self._decode_background, background)
        return Evidence(
            fields=fields_along(rays, decode, self.config.loss, generator),
            beyond=self._beyond(seen, observation, decode, generator),
            background=background,
            embeddings=embeddings,
            log_prescope=log_prescope,
            **self._sizes(seen),
        )

    def _rays_of(self, seen: Observation, observation: Observation) -> int:
        """How many rays go through pixels that are encoded: half of them where there are others."""
        rays = self.config.train.rays
        return rays if seen is observation else rays // 2

    def _beyond(
        self, seen: Observation, observation: Observation, decode: Decode, generator: torch.Generator | None
    ) -> FieldsAlongRays | None:
        """The fields along rays of all views, where not all are encoded."""
        if seen is observation:
            return None
        rays = sample_rays(observation, self.config.train.rays - self._rays_of(seen, observation), generator)
        return fields_along(rays, decode, self.config.loss, generator)

    def _sizes(self, observation: Observation) -> dict[str, Any]:
        """Of the embedding grid and of the images."""
        views, height, width = observation.depth.shape[2:]
        return {"grid": (views, *self.backbone.grid_size(height, width)), "size": (height, width)}

    def _decode_background(self, background: Latent, points: Points, directions: Points, colours: Colours) -> Decoded:
        assert self.background_field is not None
        return decode_background(
            self.background_field, background.z, points, directions, **self._world, colours=colours
        )

    def _estimate_shape(
        self, observation: Observation, inference: Inference, generator: torch.Generator | None
    ) -> Shape:
        """T_shape on one frame of each clip, drawn at random; the authors take all."""
        batch, frames = observation.depth.shape[:2]
        model = self.config.model
        return estimate_shape(
            self.object_field,
            fixed(inference.boxes),
            inference.masks.active,
            inference.what.z,
            observation,
            resolution=model.voxels,
            threshold=model.voxel_threshold,
            floor=model.floor,
            frame=torch.randint(frames, (batch,), generator=generator, device=observation.depth.device),
            generator=generator,
        )
