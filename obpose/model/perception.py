"""From RGB-D clips to embeddings and attention masks of every point (paper, section Encoder, IC-SBP)."""

from typing import Literal

import torch
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.config import Config
from obpose.data.clips import Observed, one_view
from obpose.model.attention.heads import Heads
from obpose.model.attention.icsbp import ICSBP, whole_scope
from obpose.model.attention.slot import SlotAttention, Slots
from obpose.model.attention.upsample import masks_at
from obpose.model.backbone import Backbone
from obpose.trainable import Trainable
from obpose.types import Embeddings, Masks, Observation

Points = Float[Tensor, "batch frame view height width 3"]
Prescope = Float[Tensor, "batch frame point 2"]


class Perception(Trainable):
    """What models whose masks come of one backbone have in common."""

    center: Tensor

    def __init__(self, config: Config, *, encoded: Literal["masks", "masks and latents"] = "masks and latents"):
        """Build it with fresh weights, drawn from PyTorch's global generator; some of them only latents need."""
        super().__init__()
        self.config = config
        model = config.model
        latents = encoded == "masks and latents"
        coded = latents and model.background == "component" and model.attention.kind == "icsbp"
        self.backbone = Backbone(model.backbone, scene="coded" if coded else "left out")
        self.heads = Heads(model.backbone, model.attention, background=model.background, features=latents)
        self.feature_size = model.backbone.feature + (3 if model.latent.colours == "given" else 0)
        if model.attention.kind == "icsbp":
            self.attention = ICSBP(model.attention, slots=model.slots)
        else:
            self.attention = SlotAttention(
                model.slot_attention,
                features=self.feature_size,
                slots=self.slots,
                background=model.background == "component",
                weights=model.weights,
            )
        self.register_buffer("center", torch.tensor(model.workspace_center), persistent=False)

    @property
    def slots(self) -> int:
        """Components without the background, where there is one."""
        model = self.config.model
        return model.slots if model.background == "component" else model.slots + 1

    @property
    def background_slot(self) -> int | None:
        """Label 0 where the background is a component; without one it only marks what was not observed."""
        return 0 if self.config.model.background == "component" else None

    def embed(self, observation: Observation, points: Points) -> tuple[Embeddings, Prescope | None]:
        """Backbone and heads; the second value is the log of the pre-scope, where there is one: background, s_0."""
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
        if self.config.model.latent.colours == "given":
            # The observed colours stand beside zeta_f, so that the latents need not wait for the backbone.
            features = torch.cat([features, rgb], dim=-1)
        scene = rearrange(out.scene, "(b f v) c -> b f v c", **cells).mean(dim=2)
        return Embeddings(grid, valid, rgb, colour, features, scene), log_prescope

    def attend(self, embeddings: Embeddings, log_prescope: Prescope | None, generator: torch.Generator | None) -> Masks:
        """Masks of the IC-SBP; seeds and idle slots follow the rules for training in training mode."""
        assert isinstance(self.attention, ICSBP)
        config = self.config.model.attention
        return self.attention(
            embeddings.colour,
            embeddings.valid,
            whole_scope(embeddings.valid) if log_prescope is None else log_prescope,
            slots=self.config.model.slots,
            seeds=config.seeds if self.training else config.evaluation_seeds,
            idle=config.idle_in_training if self.training else "threshold",
            division="sticks" if self.training else config.evaluation_division,
            remainder="apart" if self.config.model.background == "component" else "slot",
            generator=generator,
        )

    def attend_slots(self, embeddings: Embeddings, generator: torch.Generator | None) -> Slots:
        """Slots and masks of slot attention."""
        assert isinstance(self.attention, SlotAttention)
        return self.attention(self.in_workspace(embeddings), embeddings.valid, embeddings.features, generator=generator)

    def seen(self, observation: Observed, generator: torch.Generator | None) -> Observed:
        """What of the views is encoded in training."""
        if self.config.train.views == "one" and observation.depth.shape[2] > 1:
            return one_view(observation, generator)
        return observation

    def in_workspace(self, embeddings: Embeddings) -> Float[Tensor, "batch frame point 3"]:
        """The points of the grid, -1..1 in the workspace; its middle where nothing was observed."""
        shifted = (embeddings.points - self.center) * embeddings.valid[..., None]
        return shifted * (2 / self.config.model.workspace_size)

    def log_masks_at_pixels(
        self, masks: Masks, valid: Bool[Tensor, "batch frame point"], observation: Observation
    ) -> Float[Tensor, "batch frame component pixel"]:
        """Log of the masks at every pixel of all views; `valid` are the grid's points that were observed."""
        batch, frames, views, height, width = observation.depth.shape
        grid = self.backbone.grid_size(height, width)
        if grid == (height, width):
            return masks.log_masks
        pixels = torch.arange(views * height * width, device=valid.device).expand(batch, frames, -1)
        return masks_at(masks.log_masks, valid, pixels, grid=(views, *grid), size=(height, width))

    @torch.no_grad()
    def pixel_owners(
        self, masks: Masks, valid: Bool[Tensor, "batch frame point"], observation: Observation
    ) -> Int[Tensor, "batch frame view height width"]:
        """The component with the largest attention mask at each pixel; 0 where nothing was seen."""
        owners = self.log_masks_at_pixels(masks, valid, observation).argmax(dim=2)
        return owners.view_as(observation.valid) * observation.valid
