"""Locations of objects: the centres of their observed points, and the learned correction, the `where` module.

Paper, section Object Location and Orientation Conditioned Encoding. The input of `where` are unrotated boxes at the
observed centres, {T, I}.
"""

import torch
from einops import rearrange, repeat
from jaxtyping import Float, Int
from torch import Tensor, nn

from obpose.config import ModelConfig
from obpose.geometry import full_precision
from obpose.model.layers.latent import LATENT, RecurrentLatent
from obpose.model.layers.mlp import mlp
from obpose.model.layers.numerics import sharpen
from obpose.types import ComponentMasks, Draw, GridPoints, GridValid, Latent

MIN_POINTS = 1
"""A slot keeps its location from the previous frame if it has the largest mask at fewer points of the embedding grid.
[ours; code: 10 of 64x64]"""


@torch.no_grad()
@full_precision
def observed_center(
    log_masks: ComponentMasks, points: GridPoints, valid: GridValid, *, exponent: float, min_points: int = MIN_POINTS
) -> Float[Tensor, "batch frame slot 3"]:
    """T, world frame, metres: mean of the observed points weighted by a power of the slot's soft mask.

    The paper takes the plain mean of the points whose largest mask is the slot's. A soft mean is smooth and never of an
    empty set. The authors' code weights it by the mask itself (see `sharpen`), and traces of the mask on the table pull
    T away from small objects by centimetres.

    With fewer than `min_points` points, T is that of the last frame with enough points (or of the first frame). The
    authors keep the corrected location T_hat, which `where` then corrects again.
    """
    # Soft mean of each frame, by a softmax over the points, which is stable for small masks; 0 without points.
    unobserved = rearrange(~valid, "b f point -> b f 1 point")
    log_weights = sharpen(log_masks[:, :, 1:].to(points.dtype), exponent).masked_fill(unobserved, -torch.inf)
    center = log_weights.softmax(dim=-1).nan_to_num(0) @ points
    # Slots with few points keep the location of the last frame with enough points.
    seen = count_points(log_masks, valid) >= min_points
    frames = rearrange(torch.arange(seen.shape[1], device=seen.device), "frame -> frame 1")
    last_seen = (seen * frames).cummax(dim=1).values
    return center.gather(1, repeat(last_seen, "b f slot -> b f slot 3"))


def count_points(log_masks: ComponentMasks, valid: GridValid) -> Int[Tensor, "batch frame slot"]:
    """N_k: number of observed points at which the slot's mask is the largest."""
    # On a CPU the indices of max are eight times as fast as argmax.
    owner = log_masks.max(dim=2).indices.masked_fill(~valid, 0)
    slots = torch.arange(1, log_masks.shape[2], device=log_masks.device)
    return (rearrange(owner, "b f point -> b f 1 point") == rearrange(slots, "slot -> slot 1")).sum(dim=-1)


_TRANSLATION_WIDTH = 256
"""Hidden width of f_where. [code]"""


class Where(nn.Module):
    """q(z_where | x_<=t), its prior, and the translation that z_where stands for."""

    def __init__(self, code: int, config: ModelConfig):
        """Initialise the weights, for codes with `code` channels."""
        super().__init__()
        self._latent = RecurrentLatent(code, config.latent, weights=config.weights)
        self._translation = mlp(LATENT, _TRANSLATION_WIDTH, 3)
        self._max_translation = config.pose.max_translation

    def forward(
        self, code: Float[Tensor, "batch frame slot code"], draw: Draw, generator: torch.Generator | None = None
    ) -> Latent:
        """z_where from the object encoder's codes."""
        return self._latent(code, draw, generator)

    def translation(self, z: Float[Tensor, "*shape latent"]) -> Float[Tensor, "*shape 3"]:
        """Delta T = T_max tanh(f_where(z_where)), world frame, metres (paper, eq. 7)."""
        return self._max_translation * torch.tanh(self._translation(z))
