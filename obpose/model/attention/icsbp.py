"""Instance colouring stick-breaking process for video (paper, section IC-SBP; Engelcke et al. 2021, GENESIS-V2).

Masks are kept as logarithms. Seeds are points of the first frame, chosen slot by slot. In the paper they stay there,
and the mask of a seed at the edge of its object covers half of it. As an addition, seeds move by mean shift: a few
steps in the first frame, and again in every later frame from their position in the frame before. Embeddings contain the
position, so an object would otherwise slide out of its mask. Gradients reach seeds only through the embeddings of which
they are the mean. The masks of all frames are then computed at once.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from einops import rearrange, repeat
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn.functional import pad

from obpose.config import AttentionConfig, ModelConfig
from obpose.model.attention.interface import EXCLUDED, Attended, Attention
from obpose.model.layers.numerics import log1mexp, sharpen
from obpose.types import Active, Embeddings, GridValid, Masks, Prescope, SlotMasks

Seeds = Literal["stochastic", "greedy", "densest"]
Inactive = Literal["never", "bernoulli", "threshold"]
Division = Literal["stick_breaking", "softmax"]

Colours = Float[Tensor, "batch frame point colour"]
FirstColours = Float[Tensor, "batch point colour"]
"""Colour embeddings of the first frame, or of one frame."""
SeedColours = Float[Tensor, "batch slot colour"]
FirstScope = Float[Tensor, "batch point"]
LogAlpha = SlotMasks

INACTIVE_SCOPE = 0.7
"""Remaining scope that counts as large for the `threshold` rule of inactive slots. [ours]"""
MOST_ALPHA = 1e-6
"""Log alpha is at most minus this, so that a seed never takes all of a point. [code: alpha of at most 1 - 1e-6]"""
LEAST_ALPHA = 1e3
"""Negative lower bound of log alpha, so that it and its gradient are finite at every distance."""
_LEAST_POINTS = 0.5
"""A seed does not move if its sharpened mask sums to less than this many points."""
_LEAST_LOG = -80.0
_CANDIDATES = 256
"""Number of candidates for the densest point."""


@dataclass(frozen=True)
class Rules:
    """Rules that differ between training and evaluation."""

    seeds: Seeds
    """`stochastic`: argmax of u * scope with u uniform in 0..1 (GENESIS-V2); `greedy`: argmax of the scope; `densest`:
    the candidate with the largest scope around it, summed under its kernel."""
    inactive: Inactive
    """A slot is inactive if a Bernoulli draw from the remaining scope selects no point (`bernoulli`, as in the
    authors' code), or if fewer than `inactive_points` points have a remaining scope over `INACTIVE_SCOPE`
    (`threshold`)."""
    division: Division
    """Division of points within reach of several slots."""


def training_rules(config: AttentionConfig) -> Rules:
    """Rules in training."""
    return Rules("stochastic", config.inactive_in_training, "stick_breaking")


def evaluation_rules(config: AttentionConfig) -> Rules:
    """Deterministic rules at evaluation."""
    return Rules(config.evaluation_seeds, "threshold", config.evaluation_division)


def initial_sigma(slots: int) -> float:
    """Bandwidth sigma at which alpha is one half at a squared distance of 1/K."""
    return 1 / (slots * math.log(2))


def log_alpha(distance: Float[Tensor, "*shape"], log_sigma: Float[Tensor, ""]) -> Float[Tensor, "*shape"]:
    """Log of the Gaussian kernel psi, -d^2/sigma, within bounds that keep log alpha and log(1 - alpha) finite."""
    return -(distance.square() * torch.exp(-log_sigma) + MOST_ALPHA).clamp(max=LEAST_ALPHA)


def whole_scope(valid: GridValid) -> Prescope:
    """Log of a pre-scope without a background: s_0 = 1, as in the paper's equation and GENESIS-V2."""
    return torch.stack([torch.where(valid, EXCLUDED, 0.0), torch.where(valid, 0.0, EXCLUDED)], dim=-1)


class ICSBP(Attention):
    """Clusters point embeddings into soft masks, one slot after the other, each around a seed from the first frame."""

    log_sigma: Tensor

    def __init__(self, config: ModelConfig):
        """Initialise the bandwidth of the kernel."""
        super().__init__()
        self.config, self.slots, self._has_background = config.attention, config.slots, config.has_background
        self.log_sigma = nn.Parameter(torch.tensor(math.log(initial_sigma(config.slots))))

    def forward(self, embeddings: Embeddings, generator: torch.Generator | None) -> Attended:
        """Masks of all frames, by the rules for training in training mode, else by those for evaluation."""
        rules = training_rules(self.config) if self.training else evaluation_rules(self.config)
        prescope = whole_scope(embeddings.valid) if embeddings.log_prescope is None else embeddings.log_prescope
        found = (embeddings.colour, embeddings.valid, prescope)
        masks = self.masks(*found, slots=self.slots, rules=rules, generator=generator)
        if not self._has_background:
            masks = add_remainder_slot(masks)
        return Attended(masks, slot_codes=None, background_code=embeddings.scene)

    def background_code(self, embeddings: Embeddings, generator: torch.Generator | None) -> Tensor:
        """Code of the background: that of the scene, for which no masks are needed."""
        return embeddings.scene

    def masks(
        self,
        colour: Colours,
        valid: GridValid,
        log_prescope: Prescope,
        *,
        slots: int,
        rules: Rules,
        generator: torch.Generator | None,
    ) -> Masks:
        """Masks of the background and of `slots` objects in every frame.

        Slots are also inactive if the first frame has no valid point. Invalid points belong to the background and have
        no influence.
        """
        wide = torch.promote_types(colour.dtype, torch.float32)
        colour, log_prescope = colour.to(wide), log_prescope.to(wide)
        # Seeds in the first frame, then in all frames.
        log_scope = log_prescope[:, 0, :, 1].detach()
        first, active, log_residual_scope = self._choose_seeds(
            colour[:, 0], valid[:, 0], log_scope, slots=slots, rules=rules, generator=generator
        )
        if self.config.mean_shift_steps:
            seeds = self._follow(colour, valid, log_prescope, first, active)
        else:
            seeds = repeat(first, "b slot colour -> b frame slot colour", frame=colour.shape[1])
        # Masks from the distances to the seeds.
        alpha = self._log_alpha(colour, seeds)
        if rules.division == "stick_breaking":
            return break_sticks(alpha, log_prescope, valid, active)
        return divide_by_softmax(alpha, log_prescope, valid, active, log_residual_scope, self.config.mask_exponent)

    def _follow(
        self, colour: Colours, valid: GridValid, log_prescope: Prescope, first: SeedColours, active: Active
    ) -> Float[Tensor, "batch frame slot colour"]:
        """Seeds of all frames, by mean shift from their position in the frame before."""
        scope = log_prescope[..., 1].detach().exp() * valid
        seed, seeds = first, []
        for frame in range(colour.shape[1]):
            for _ in range(self.config.mean_shift_steps):
                with torch.no_grad():
                    # m_k = s_{k-1} alpha_k (paper, eq. 1).
                    alpha = _exp(self._log_alpha_at(seed, colour[:, frame])) * active[..., None]
                    remaining = pad(1 - alpha[:, :-1], (0, 0, 1, 0), value=1).cumprod(dim=1)
                    masks = scope[:, frame, None] * alpha * remaining
                # The seed moves to the mean embedding under its sharpened mask.
                seed = mean_shift(seed.detach(), masks**self.config.mask_exponent, colour[:, frame])
            seeds.append(seed)
        return torch.stack(seeds, dim=1)

    def _choose_seeds(
        self,
        colour: FirstColours,
        valid: Bool[Tensor, "batch point"],
        log_scope: FirstScope,
        *,
        slots: int,
        rules: Rules,
        generator: torch.Generator | None,
    ) -> tuple[SeedColours, Active, Float[Tensor, "batch slot"]]:
        """Choose the slots' seeds among the points of the first frame, and which slots are active.

        The scope left to the next slot depends on the seed after its mean shift. The third value is the log of a
        slot's residual scope: the share, 0..1, of the scope around its seed that earlier slots have left.
        """
        exponent = self.config.mask_exponent
        whole = log_scope = log_scope.masked_fill(~valid, EXCLUDED)
        chosen, active, log_residual_scope = [], [], []
        for _ in range(slots):
            active.append(self._is_active(log_scope, rules, generator) & valid.any(dim=-1))
            # Seed, and its mean shift.
            seed = _pick(colour, self._choose_seed(colour, log_scope, rules, generator))
            chosen.append(seed)
            with torch.no_grad():
                for _ in range(self.config.mean_shift_steps):
                    log_mask = log_scope[:, None] + self._log_alpha_at(seed, colour)
                    seed = mean_shift(seed, _exp(sharpen(log_mask, exponent)), colour)
                # Residual scope: the share of the scope around the seed that earlier slots have left.
                alpha = self._log_alpha_at(seed, colour)[:, 0]
                near = sharpen(alpha, exponent)
                log_residual_scope.append((near + log_scope).logsumexp(dim=-1) - (near + whole).logsumexp(dim=-1))
                # s_k = s_{k-1} (1 - alpha_k) (paper, eq. 2).
                log_scope = log_scope + log1mexp(alpha) * active[-1][:, None]
        return torch.cat(chosen, dim=1), torch.stack(active, dim=-1), torch.stack(log_residual_scope, dim=-1)

    @torch.no_grad()
    def _choose_seed(
        self, colour: FirstColours, log_scope: FirstScope, rules: Rules, generator: torch.Generator | None
    ) -> Int[Tensor, "batch 1"]:
        """Index of the next seed."""
        # At the largest scope times uniform noise (GENESIS-V2), or at the largest scope.
        if rules.seeds == "stochastic":
            return (_uniform(log_scope, generator).log() + log_scope).argmax(dim=-1, keepdim=True)
        if rules.seeds == "greedy":
            return log_scope.argmax(dim=-1, keepdim=True)
        # Densest: candidates are the points with the largest scope, and count if it is over the threshold.
        best = log_scope.topk(min(_CANDIDATES, log_scope.shape[-1]), dim=-1)
        around = self._log_alpha_at(_pick(colour, best.indices), colour) + log_scope[:, None]
        density = _exp(around).sum(dim=-1) * (best.values > math.log(INACTIVE_SCOPE))
        return best.indices.gather(1, density.argmax(dim=-1, keepdim=True))

    def _is_active(
        self, log_scope: FirstScope, rules: Rules, generator: torch.Generator | None
    ) -> Bool[Tensor, "batch"]:
        """Whether a slot with this remaining scope is active."""
        if rules.inactive == "never":
            return torch.ones_like(log_scope[:, 0], dtype=torch.bool)
        # At least one point is drawn with the probability of its remaining scope.
        if rules.inactive == "bernoulli":
            return (_uniform(log_scope, generator).log() < log_scope).any(dim=-1)
        return (log_scope > math.log(INACTIVE_SCOPE)).sum(dim=-1) >= self.config.inactive_points

    def _log_alpha_at(
        self, seeds: Float[Tensor, "batch seed colour"], colour: FirstColours
    ) -> Float[Tensor, "batch seed point"]:
        return self._log_alpha(colour[:, None], seeds[:, None])[:, 0]

    def _log_alpha(self, colour: Colours, seeds: Float[Tensor, "batch frame slot colour"]) -> LogAlpha:
        # By differences: the matrix product loses all digits if embeddings are large and close to each other.
        distance = torch.cdist(seeds, colour, compute_mode="donot_use_mm_for_euclid_dist")
        return log_alpha(distance, self.log_sigma.to(colour.dtype))


def mean_shift(seed: SeedColours, weights: Float[Tensor, "batch slot point"], colour: FirstColours) -> SeedColours:
    """Move seeds to the mean embedding under their sharpened masks; seeds of nearly empty masks stay.

    So seeds of objects out of sight wait where they were.
    """
    total = weights.sum(dim=-1, keepdim=True)
    return torch.where(total >= _LEAST_POINTS, weights @ colour / total.clamp(min=_LEAST_POINTS), seed)


def break_sticks(alpha: LogAlpha, log_prescope: Prescope, valid: GridValid, active: Active) -> Masks:
    """Masks m_k = s_{k-1} alpha_k with s_k = s_{k-1} (1 - alpha_k) (paper, eq. 1 and 2), from log alpha.

    Deviations, as in the authors' code: s_0 is the pre-scope, so there is a background mask. The last slot does not
    take the remainder: s_K is kept separately, and a loss penalises it.
    """
    left = _log_left(alpha, active)
    # s_k = s_{k-1} (1 - alpha_k), in log space.
    scopes = torch.cat([log_prescope[:, :, None, :, 1], left], dim=2).cumsum(dim=2)
    return _masks(scopes[:, :, :-1] + alpha, scopes[:, :, -1], log_prescope, valid, active)


def divide_by_softmax(
    alpha: LogAlpha,
    log_prescope: Prescope,
    valid: GridValid,
    active: Active,
    log_residual_scope: Float[Tensor, "batch slot"],
    exponent: float,
) -> Masks:
    """Divide the scope that stick breaking would assign by a softmax over powers of alpha times residual scope.

    An addition. In stick breaking the first slot takes a third of a neighbour at a distance of one kernel width. In the
    softmax the nearer slot takes nearly all. The residual scope keeps slots that start on what others left from taking
    half of their objects.
    """
    # Scope that stick breaking takes in all: 1 - prod_k (1 - alpha_k).
    left = _log_left(alpha, active).sum(dim=2)
    taken = log1mexp(left.clamp(max=-torch.finfo(left.dtype).tiny)) + log_prescope[..., 1]
    # Shares by powers of alpha times residual scope.
    strength = sharpen(alpha + rearrange(log_residual_scope, "b slot -> b 1 slot 1"), exponent)
    in_use = rearrange(active, "b slot -> b 1 slot 1")
    log_shares = strength.masked_fill(~in_use, EXCLUDED).log_softmax(dim=2)
    return _masks(taken[:, :, None] + log_shares, left + log_prescope[..., 1], log_prescope, valid, active)


def add_remainder_slot(masks: Masks) -> Masks:
    """Add a slot that takes the remaining scope: m_K = s_{K-1}, as in the paper's eq. 1 and GENESIS-V2."""
    return Masks(
        log_masks=torch.cat([masks.log_masks, masks.log_scope[:, :, None]], dim=2),
        log_scope=torch.full_like(masks.log_scope, EXCLUDED),
        active=pad(masks.active, (0, 1), value=True),
    )


def _log_left(alpha: LogAlpha, active: Active) -> LogAlpha:
    """Log of the share that each slot leaves: log(1 - alpha), 0 for inactive slots."""
    return log1mexp(alpha) * rearrange(active, "b slot -> b 1 slot 1")


def _masks(
    masks: LogAlpha,
    log_scope: Float[Tensor, "batch frame point"],
    log_prescope: Prescope,
    valid: GridValid,
    active: Active,
) -> Masks:
    there = valid[:, :, None] & rearrange(active, "b slot -> b 1 slot 1")
    # Invalid points belong to the background: log 1 = 0.
    background = log_prescope[..., 0] * valid
    return Masks(
        log_masks=torch.cat([background[:, :, None], masks.masked_fill(~there, EXCLUDED)], dim=2),
        log_scope=log_scope.masked_fill(~valid, EXCLUDED),
        active=active,
    )


def _exp(logarithm: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Exponential that avoids subnormal numbers, which are ten times as slow on a CPU."""
    return logarithm.clamp(min=_LEAST_LOG).exp()


def _uniform(like: Tensor, generator: torch.Generator | None) -> Tensor:
    drawn = torch.rand(like.shape, generator=generator, device=like.device, dtype=like.dtype)
    return drawn.clamp(min=torch.finfo(like.dtype).tiny)


def _pick(colour: FirstColours, index: Int[Tensor, "batch place"]) -> Float[Tensor, "batch place colour"]:
    return colour.gather(1, repeat(index, "b place -> b place colour", colour=colour.shape[-1]))
