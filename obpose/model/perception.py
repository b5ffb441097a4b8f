"""Functions shared by models whose masks come from backbone, heads and attention (paper, section Encoder).

Their masks do not depend on what the fields make of their points. Points at a border, or of an object that two masks
share, are explained better by one of the fields. So masks become posteriors: an E-step of the fields' mixture.
"""

from dataclasses import replace

import torch
from einops import rearrange
from jaxtyping import Float, Int
from torch import Tensor

from obpose.config import ModelConfig, Views
from obpose.data.clips import Observed, random_view
from obpose.model.attention.heads import Heads
from obpose.model.attention.interface import EXCLUDED
from obpose.model.attention.upsample import masks_at
from obpose.model.backbone import Backbone
from obpose.model.nerf.compose import log_share
from obpose.types import ComponentMasks, Embeddings, GridValid, Masks, Observation

Points = Float[Tensor, "batch frame view height width 3"]


def select_input_views(observation: Observed, views: Views, generator: torch.Generator | None) -> Observed:
    """Select the views that are encoded in training."""
    if views == "random" and observation.depth.shape[2] > 1:
        return random_view(observation, generator)
    return observation


def embed(
    backbone: Backbone,
    heads: Heads,
    observation: Observation,
    points: Points,
    *,
    config: ModelConfig,
    center: Float[Tensor, "3"],
) -> Embeddings:
    """Embed the surface points of an observation; `center` is the middle of the workspace."""
    axes = dict(zip("bfv", points.shape[:3], strict=True))
    # Backbone: each image separately.
    out = backbone(
        rearrange(points, "b f v h w c -> (b f v) h w c"),
        rearrange(observation.rgb, "b f v h w c -> (b f v) h w c"),
        rearrange(observation.valid, "b f v h w -> (b f v) h w"),
        spacing=config.spacing,
        center=center,
        workspace_radius=config.workspace_size / 2,
    )
    grid, rgb, embedding = (
        rearrange(part, "(b f v) h w c -> b f (v h w) c", **axes) for part in (out.points, out.rgb, out.embedding)
    )
    valid = rearrange(out.valid, "(b f v) h w -> b f (v h w)", **axes)
    scene = rearrange(out.scene, "(b f v) c -> b f v c", **axes).mean(dim=2)
    # Heads: each point separately.
    colour, features, log_prescope = heads(grid, valid, rgb, embedding, center=center)
    # Positions in the workspace, for slot attention.
    position = (grid - center) * valid[..., None] * (2 / config.workspace_size)
    return Embeddings(grid, valid, position, rgb, colour, features, scene, log_prescope)


@torch.no_grad()
def pixel_owners(
    masks: Masks, valid: GridValid, observation: Observation, *, grid: tuple[int, int]
) -> Int[Tensor, "batch frame view height width"]:
    """Component with the largest attention mask at each pixel; 0 for pixels without depth.

    `grid` are rows and columns of the embedding grid of an image.
    """
    batch, frames, views, height, width = observation.depth.shape
    log_masks = masks.log_masks
    if grid != (height, width):
        pixels = torch.arange(views * height * width, device=valid.device).expand(batch, frames, -1)
        log_masks = masks_at(log_masks, valid, pixels, grid=(views, *grid), size=(height, width))
    owners = log_masks.max(dim=2).indices  # on a CPU six times as fast as argmax
    return owners.view_as(observation.valid) * observation.valid


def posterior_masks(masks: Masks, logits: ComponentMasks, log_likelihood: ComponentMasks, valid: GridValid) -> Masks:
    """Masks m_k in proportion to sigma_hat_k N(x | c_k), from density logits and log-likelihoods of the colours.

    This is the posterior of the mixture in the first term of L_obs (paper, section Training), with one likelihood for
    all colour channels. No scope remains. Invalid points belong to the background, which is the first component.
    """
    posterior = (log_share(logits) + log_likelihood).log_softmax(dim=2).clamp(min=EXCLUDED)
    nobody = torch.full_like(posterior, EXCLUDED)
    nobody[:, :, 0] = 0
    return replace(
        masks,
        log_masks=torch.where(valid[:, :, None], posterior, nobody),
        log_scope=torch.full_like(masks.log_scope, EXCLUDED),
    )
