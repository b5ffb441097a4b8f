"""Instance colouring stick-breaking process for video (paper, section IC-SBP; Engelcke et al. 2021, GENESIS-V2).

Everything is kept as logarithms. Which points are seeds is decided on the first frame, slot by slot and without
gradients, and how far seeds move in later frames, frame by frame; then all slots of all frames are computed at once,
with gradients also into the embeddings of the seeds.

The paper's seeds stay where they were in the first frame. With embeddings that hold the position an object then slides
out of its own mask: of an object that has moved, ours are moved by as much as the mean embedding under its mask has.
"""

import math
from typing import Literal

import torch
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from obpose.attention.kernels import initial_sigma, log_alpha
from obpose.config import AttentionConfig
from obpose.layers.numerics import log1mexp
from obpose.types import Masks

Seeds = Literal["stochastic", "greedy"]
Idle = Literal["never", "bernoulli", "threshold"]

EXCLUDED = -1e4
"""Log mask of an idle slot, and of all slots at an invalid point: lower than any other, finite in half precision."""

_SHARPNESS = 3
"""Power of the mask by which the mean embedding is weighted: traces of it on a whole table are not to count."""
_LOOKS = 2
"""So often a seed moves to the mean of its mask, from where it was in the frame before."""
_SEEN = 0.5
"""A mask whose powers sum to less, in points, covers nothing of which the middle could be told."""


class ICSBP(nn.Module):
    """Clusters point embeddings into soft masks, one slot after the other, each around a seed from the first frame."""

    log_sigma: Tensor

    def __init__(self, config: AttentionConfig, *, slots: int):
        """`slots` only sets the initial bandwidth."""
        super().__init__()
        self.config = config
        self.log_sigma = nn.Parameter(torch.tensor(math.log(initial_sigma(config.kernel, slots=slots))))

    def forward(
        self,
        colour: Float[Tensor, "batch frame point colour"],
        valid: Bool[Tensor, "batch frame point"],
        log_prescope: Float[Tensor, "batch frame point 2"],
        *,
        slots: int,
        seeds: Seeds,
        idle: Idle,
        generator: torch.Generator | None,
    ) -> Masks:
        """Masks of the background and of `slots` objects in every frame.

        A slot is idle where the rule `idle` says so of the scope left to it in the first frame, and where that frame
        has no valid point: `bernoulli` as in the authors' code, where a draw of the scope at each point finds none;
        `threshold` where fewer than `idle_points` points have a scope over `idle_scope`. Points that are not valid
        belong to the background and have no influence.
        """
        wide = torch.promote_types(colour.dtype, torch.float32)
        colour, log_prescope = colour.to(wide), log_prescope.to(wide)
        places, active = self._choose_seeds(
            colour[:, 0],
            valid[:, 0],
            log_prescope[:, 0, :, 1],
            slots=slots,
            seeds=seeds,
            idle=idle,
            generator=generator,
        )
        first = _pick(colour[:, 0], places)[:, None]
        moved = self._follow(colour, valid, log_prescope, first, active) if self.config.moving_seeds else 0.0
        alpha = self._log_alpha(colour, (first + moved).expand(-1, colour.shape[1], -1, -1))
        return _break_sticks(alpha, log_prescope, valid, active)

    @torch.no_grad()
    def _follow(
        self,
        colour: Float[Tensor, "batch frame point colour"],
        valid: Bool[Tensor, "batch frame point"],
        log_prescope: Float[Tensor, "batch frame point 2"],
        first: Float[Tensor, "batch 1 slot colour"],
        active: Bool[Tensor, "batch slot"],
    ) -> Float[Tensor, "batch frame slot colour"]:
        """How far the mean embedding under each mask has moved since it was first seen, frame by frame.

        A mask around the seed of the frame before shows where the seed is to move. While that mask covers next to
        nothing, as of an object out of sight, the seed waits.
        """
        moved, start, shift = [], torch.full_like(first, math.nan), torch.zeros_like(first)
        for frame in range(colour.shape[1]):
            here = slice(frame, frame + 1)
            for _ in range(_LOOKS if frame else 1):
                alpha = self._log_alpha(colour[:, here], first + shift)
                masks = _break_sticks(alpha, log_prescope[:, here], valid[:, here], active).log_masks[:, :, 1:]
                sharp = (_SHARPNESS * masks).exp()
                total = sharp.sum(dim=-1, keepdim=True)
                mean, seen = sharp @ colour[:, here] / total.clamp(min=_SEEN), total >= _SEEN
                start = torch.where(seen & start.isnan(), mean, start)
                shift = torch.where(seen, mean - start, shift)
            moved.append(shift)
        return torch.cat(moved, dim=1)

    @torch.no_grad()
    def _choose_seeds(
        self,
        colour: Float[Tensor, "batch point colour"],
        valid: Bool[Tensor, "batch point"],
        log_scope: Float[Tensor, "batch point"],
        *,
        slots: int,
        seeds: Seeds,
        idle: Idle,
        generator: torch.Generator | None,
    ) -> tuple[Int[Tensor, "batch slot"], Bool[Tensor, "batch slot"]]:
        """Place of each slot's seed among the points of the first frame, and which slots are in use."""
        log_scope = log_scope.masked_fill(~valid, -math.inf)
        places, active = [], []
        for _ in range(slots):
            active.append(self._find_points(log_scope, idle, generator) & valid.any(dim=-1))
            places.append(_choose_seed(log_scope, seeds, generator))
            alpha = self._log_alpha(colour[:, None], _pick(colour, places[-1][:, None])[:, None])[:, 0, 0]
            log_scope = log_scope + log1mexp(alpha) * active[-1][:, None]
        return torch.stack(places, dim=-1), torch.stack(active, dim=-1)

    def _find_points(
        self, log_scope: Float[Tensor, "batch point"], idle: Idle, generator: torch.Generator | None
    ) -> Bool[Tensor, "batch"]:
        if idle == "never":
            return torch.ones_like(log_scope[:, 0], dtype=torch.bool)
        if idle == "bernoulli":
            return (_uniform(log_scope, generator).log() < log_scope).any(dim=-1)
        return (log_scope > math.log(self.config.idle_scope)).sum(dim=-1) >= self.config.idle_points

    def _log_alpha(
        self, colour: Float[Tensor, "batch frame point colour"], seeds: Float[Tensor, "batch frame slot colour"]
    ) -> Float[Tensor, "batch frame slot point"]:
        # Differences, not the matrix product, which has no digits left where embeddings are large and near each other.
        distance = torch.cdist(seeds, colour, compute_mode="donot_use_mm_for_euclid_dist")
        return log_alpha(distance, self.log_sigma.to(colour.dtype), self.config.kernel)


def _choose_seed(
    log_scope: Float[Tensor, "batch point"], seeds: Seeds, generator: torch.Generator | None
) -> Int[Tensor, "batch"]:
    """Argmax of u * s with u uniform in 0..1 (GENESIS-V2), or of s."""
    if seeds == "greedy":
        return log_scope.argmax(dim=-1)
    return (_uniform(log_scope, generator).log() + log_scope).argmax(dim=-1)


def _uniform(like: Tensor, generator: torch.Generator | None) -> Tensor:
    drawn = torch.rand(like.shape, generator=generator, device=like.device, dtype=like.dtype)
    return drawn.clamp(min=torch.finfo(like.dtype).tiny)


def _pick(
    colour: Float[Tensor, "batch point colour"], places: Int[Tensor, "batch slot"]
) -> Float[Tensor, "batch slot colour"]:
    return colour.gather(1, places[..., None].expand(-1, -1, colour.shape[-1]))


def _break_sticks(
    alpha: Float[Tensor, "batch frame slot point"],
    log_prescope: Float[Tensor, "batch frame point 2"],
    valid: Bool[Tensor, "batch frame point"],
    active: Bool[Tensor, "batch slot"],
) -> Masks:
    """Masks m_k = s_{k-1} alpha_k with s_k = s_{k-1} (1 - alpha_k) (paper, section IC-SBP), from log alpha.

    Deviations, as in the authors' code: s_0 is the pre-scope, so there is a background mask, and the last slot takes
    no remainder: s_K stays apart, and a loss penalises it.
    """
    background, scope = log_prescope.unbind(dim=-1)
    in_use = rearrange(active, "b slot -> b 1 slot 1")
    left = log1mexp(alpha) * in_use
    scopes = torch.cat([scope[:, :, None], left], dim=2).cumsum(dim=2)
    masks = (scopes[:, :, :-1] + alpha).masked_fill(~in_use, EXCLUDED)
    there = valid[:, :, None]
    return Masks(
        log_masks=torch.cat(
            [(background * valid)[:, :, None], masks.masked_fill(~there, EXCLUDED)],
            dim=2,
        ),
        log_scope=scopes[:, :, -1].masked_fill(~valid, EXCLUDED),
        active=active,
    )
