"""Instance colouring stick-breaking process for video (paper, section IC-SBP; Engelcke et al. 2021, GENESIS-V2).

Masks are kept as logarithms, but where seeds look. Seeds are points of the first frame, chosen slot by slot. The
paper's stay there, and where a point is at the edge of its object its mask covers half of it. An addition lets seeds
move to the mean embedding under their masks, a few times in the first frame, and again in every later one from where
they were in the frame before, since with embeddings that hold the position an object slides out of a mask that stays.
Where seeds are has no gradient, but for the embeddings that they are means of; the masks of all frames are then
computed at once.
"""

import math
from typing import Literal

import torch
from einops import rearrange, repeat
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import pad

from obpose.config import AttentionConfig
from obpose.model.attention.kernels import initial_sigma, log_alpha
from obpose.model.layers.numerics import log1mexp, sharpen
from obpose.types import Masks

Seeds = Literal["stochastic", "greedy", "densest"]
Idle = Literal["never", "bernoulli", "threshold"]
Division = Literal["sticks", "shares"]
Remainder = Literal["apart", "slot"]

EXCLUDED = -1e4
"""Log mask of an idle slot, and of all slots at an invalid point: lower than any other, finite in half precision."""

_SEEN = 0.5
"""A sharpened mask that sums to less, in points, covers nothing of which the middle could be told."""
_LEAST = -80.0
"""Log of next to nothing."""
_CANDIDATES = 256
"""So many points are compared for the densest."""


def whole_scope(valid: Bool[Tensor, "batch frame point"]) -> Float[Tensor, "batch frame point 2"]:
    """Log of a pre-scope without a background: s_0 = 1, as in the paper's equation and GENESIS-V2."""
    return torch.stack([torch.where(valid, EXCLUDED, 0.0), torch.where(valid, 0.0, EXCLUDED)], dim=-1)


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
        division: Division = "sticks",
        remainder: Remainder = "apart",
        generator: torch.Generator | None,
    ) -> Masks:
        """Masks of the background and of `slots` objects in every frame, and of one more that takes the `remainder`.

        A slot is idle where the rule `idle` says so of the scope left to it in the first frame, and where that frame
        has no valid point: `bernoulli` as in the authors' code, where a draw of the scope at each point finds none;
        `threshold` where fewer than `idle_points` points have a scope over `idle_scope`. Points that are not valid
        belong to the background and have no influence. What several slots reach is divided by breaking sticks, or in
        shares.
        """
        wide = torch.promote_types(colour.dtype, torch.float32)
        colour, log_prescope = colour.to(wide), log_prescope.to(wide)
        first, active, log_claims = self._choose_seeds(
            colour[:, 0],
            valid[:, 0],
            log_prescope[:, 0, :, 1].detach(),
            slots=slots,
            seeds=seeds,
            idle=idle,
            generator=generator,
        )
        if self.config.looks:
            places = self._follow(colour, valid, log_prescope, first, active)
        else:
            places = repeat(first, "b slot colour -> b frame slot colour", frame=colour.shape[1])
        alpha = self._log_alpha(colour, places)
        if division == "sticks":
            masks = _break_sticks(alpha, log_prescope, valid, active)
        else:
            masks = _share(alpha, log_prescope, valid, active, log_claims, self.config.mask_power)
        return masks if remainder == "apart" else _take_remainder(masks)

    def _follow(
        self,
        colour: Float[Tensor, "batch frame point colour"],
        valid: Bool[Tensor, "batch frame point"],
        log_prescope: Float[Tensor, "batch frame point 2"],
        first: Float[Tensor, "batch slot colour"],
        active: Bool[Tensor, "batch slot"],
    ) -> Float[Tensor, "batch frame slot colour"]:
        """Seeds of all frames, each looked for from where it was in the frame before."""
        scope = log_prescope[..., 1].detach().exp() * valid
        seed, places = first, []
        for frame in range(colour.shape[1]):
            for _ in range(self.config.looks):
                with torch.no_grad():
                    alpha = _exp(self._alpha_around(seed, colour[:, frame])) * active[..., None]
                    masks = scope[:, frame, None] * alpha * _left_before(alpha)
                seed = _look(seed.detach(), masks**self.config.mask_power, colour[:, frame])
            places.append(seed)
        return torch.stack(places, dim=1)

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
    ) -> tuple[Float[Tensor, "batch slot colour"], Bool[Tensor, "batch slot"], Float[Tensor, "batch slot"]]:
        """The embeddings of the points of the first frame that are the slots' seeds, and which slots are in use.

        What a slot leaves to the next is what is left around the place that its seed will move to. The last value is
        the log of a slot's claim, 0..1: the share of the scope there that the slots before it have left.
        """
        whole = log_scope = log_scope.masked_fill(~valid, EXCLUDED)
        chosen, active, log_claims = [], [], []
        for _ in range(slots):
            active.append(self._find_points(log_scope, idle, generator) & valid.any(dim=-1))
            seed = _pick(colour, self._choose_seed(colour, log_scope, seeds, generator))
            chosen.append(seed)
            with torch.no_grad():
                for _ in range(self.config.looks):
                    log_mask = log_scope[:, None] + self._alpha_around(seed, colour)
                    seed = _look(seed, _exp(sharpen(log_mask, self.config.mask_power)), colour)
                alpha = self._alpha_around(seed, colour)[:, 0]
                near = sharpen(alpha, self.config.mask_power)
                log_claims.append((near + log_scope).logsumexp(dim=-1) - (near + whole).logsumexp(dim=-1))
                log_scope = log_scope + log1mexp(alpha) * active[-1][:, None]
        return torch.cat(chosen, dim=1), torch.stack(active, dim=-1), torch.stack(log_claims, dim=-1)

    @torch.no_grad()
    def _choose_seed(
        self,
        colour: Float[Tensor, "batch point colour"],
        log_scope: Float[Tensor, "batch point"],
        seeds: Seeds,
        generator: torch.Generator | None,
    ) -> Int[Tensor, "batch 1"]:
        """Place of the argmax of u * s with u uniform in 0..1 (GENESIS-V2), or of s, or of the densest point.

        The densest point has the largest scope around it, summed under its kernel, of those with an own scope over
        `idle_scope`, or of the points with the largest scope where there are more.
        """
        if seeds == "stochastic":
            return (_uniform(log_scope, generator).log() + log_scope).argmax(dim=-1, keepdim=True)
        if seeds == "greedy":
            return log_scope.argmax(dim=-1, keepdim=True)
        best = log_scope.topk(min(_CANDIDATES, log_scope.shape[-1]), dim=-1)
        around = self._alpha_around(_pick(colour, best.indices), colour) + log_scope[:, None]
        density = around.exp().sum(dim=-1) * (best.values > math.log(self.config.idle_scope))
        return best.indices.gather(1, density.argmax(dim=-1, keepdim=True))

    def _find_points(
        self, log_scope: Float[Tensor, "batch point"], idle: Idle, generator: torch.Generator | None
    ) -> Bool[Tensor, "batch"]:
        if idle == "never":
            return torch.ones_like(log_scope[:, 0], dtype=torch.bool)
        if idle == "bernoulli":
            return (_uniform(log_scope, generator).log() < log_scope).any(dim=-1)
        return (log_scope > math.log(self.config.idle_scope)).sum(dim=-1) >= self.config.idle_points

    def _alpha_around(
        self, seeds: Float[Tensor, "batch seed colour"], colour: Float[Tensor, "batch point colour"]
    ) -> Float[Tensor, "batch seed point"]:
        return self._log_alpha(colour[:, None], seeds[:, None])[:, 0]

    def _log_alpha(
        self, colour: Float[Tensor, "batch frame point colour"], seeds: Float[Tensor, "batch frame slot colour"]
    ) -> Float[Tensor, "batch frame slot point"]:
        # Differences, not the matrix product, which has no digits left where embeddings are large and near each other.
        distance = torch.cdist(seeds, colour, compute_mode="donot_use_mm_for_euclid_dist")
        return log_alpha(distance, self.log_sigma.to(colour.dtype), self.config.kernel)


def _look(
    seed: Float[Tensor, "batch slot colour"],
    weights: Float[Tensor, "batch slot point"],
    colour: Float[Tensor, "batch point colour"],
) -> Float[Tensor, "batch slot colour"]:
    """The mean embedding under each sharpened mask; a seed whose mask covers next to nothing waits where it was.

    So does that of an object out of sight.
    """
    total = weights.sum(dim=-1, keepdim=True)
    return torch.where(total >= _SEEN, weights @ colour / total.clamp(min=_SEEN), seed)


def _left_before(alpha: Float[Tensor, "batch slot point"]) -> Float[Tensor, "batch slot point"]:
    """What the slots before each leave to it."""
    return pad(1 - alpha[:, :-1], (0, 0, 1, 0), value=1).cumprod(dim=1)


def _exp(logarithm: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Shares of which sums are made, where next to nothing is as good as nothing.

    On a CPU the exponential of what has none in single precision takes ten times as long.
    """
    return logarithm.clamp(min=_LEAST).exp()


def _uniform(like: Tensor, generator: torch.Generator | None) -> Tensor:
    drawn = torch.rand(like.shape, generator=generator, device=like.device, dtype=like.dtype)
    return drawn.clamp(min=torch.finfo(like.dtype).tiny)


def _pick(
    colour: Float[Tensor, "batch point colour"], places: Int[Tensor, "batch place"]
) -> Float[Tensor, "batch place colour"]:
    return colour.gather(1, repeat(places, "b place -> b place colour", colour=colour.shape[-1]))


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
    left = _left(alpha, active)
    scopes = torch.cat([log_prescope[:, :, None, :, 1], left], dim=2).cumsum(dim=2)
    return _masks(scopes[:, :, :-1] + alpha, scopes[:, :, -1], log_prescope, valid, active)


def _share(
    alpha: Float[Tensor, "batch frame slot point"],
    log_prescope: Float[Tensor, "batch frame point 2"],
    valid: Bool[Tensor, "batch frame point"],
    active: Bool[Tensor, "batch slot"],
    log_claims: Float[Tensor, "batch slot"],
    power: float,
) -> Masks:
    """Masks that take as much of the pre-scope as sticks do, in all, in shares by powers of alpha and claim.

    An addition. A stick that is broken first takes a third of a neighbour that is as far away as the kernel is wide,
    whatever the neighbour's own slot; in shares the nearer slot takes nearly all. Their order has no influence but by
    the claims, which keep a slot that sits on what others left from halving their objects.
    """
    left = _left(alpha, active).sum(dim=2)
    taken = log1mexp(left.clamp(max=-torch.finfo(left.dtype).tiny)) + log_prescope[..., 1]
    strength = sharpen(alpha + rearrange(log_claims, "b slot -> b 1 slot 1"), power)
    in_use = rearrange(active, "b slot -> b 1 slot 1")
    shares = strength.masked_fill(~in_use, EXCLUDED).log_softmax(dim=2)
    return _masks(taken[:, :, None] + shares, left + log_prescope[..., 1], log_prescope, valid, active)


def _take_remainder(masks: Masks) -> Masks:
    """One slot more, which takes what the others leave: m_K = s_{K-1}, as in the paper's equation and GENESIS-V2."""
    return Masks(
        log_masks=torch.cat([masks.log_masks, masks.log_scope[:, :, None]], dim=2),
        log_scope=torch.full_like(masks.log_scope, EXCLUDED),
        active=pad(masks.active, (0, 1), value=True),
    )


def _left(
    alpha: Float[Tensor, "batch frame slot point"], active: Bool[Tensor, "batch slot"]
) -> Float[Tensor, "batch frame slot point"]:
    """Log of what each slot leaves of what it gets."""
    return log1mexp(alpha) * rearrange(active, "b slot -> b 1 slot 1")


def _masks(
    masks: Float[Tensor, "batch frame slot point"],
    log_scope: Float[Tensor, "batch frame point"],
    log_prescope: Float[Tensor, "batch frame point 2"],
    valid: Bool[Tensor, "batch frame point"],
    active: Bool[Tensor, "batch slot"],
) -> Masks:
    there = valid[:, :, None] & rearrange(active, "b slot -> b 1 slot 1")
    background = log_prescope[..., 0] * valid
    return Masks(
        log_masks=torch.cat([background[:, :, None], masks.masked_fill(~there, EXCLUDED)], dim=2),
        log_scope=log_scope.masked_fill(~valid, EXCLUDED),
        active=active,
    )
