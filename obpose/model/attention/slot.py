"""Slot attention over the points of a clip (Locatello et al. 2020; the paper's ablation in the place of the IC-SBP).

Object slots are alike: they share their distribution and all weights. The background's slot has its own of both but
for the keys, as in the authors' code. Slots of a frame begin where those of the frame before ended.

In training the first slots are samples, which pass gradients on to the distribution (in the authors' code, and in that
of others, they do not, and nothing of the distribution is learned or saved). At evaluation nothing may be random, and
equal slots would stay equal for ever: the noise of the objects' slots was drawn once and is saved with the weights, the
background's is its mean.
"""

from typing import NamedTuple

import torch
from einops import rearrange
from jaxtyping import Bool, Float
from torch import Tensor, nn

from obpose.config import SlotAttentionConfig, Weights
from obpose.model.attention.icsbp import EXCLUDED
from obpose.model.layers.mlp import mlp, pass_on
from obpose.model.nerf.field import positional_encoding
from obpose.types import Masks

_LEAST_SHARE = 1e-8
"""Is added to the slots' shares before they are normalised over tokens, as in the paper of slot attention."""
_QUERY_GAIN = 2.0
"""Of queries and keys where weights are orthogonal: slots share out the points from the start. PyTorch's own weights
give all slots nearly the same of every point, and so nearly the same codes."""
_EVALUATION_SEED = 0
"""Of the other draw of a distribution that is not learned."""


class Slots(NamedTuple):
    """What slot attention finds."""

    masks: Masks
    """At each valid point the slots' shares of the last iteration, which sum to one; no scope remains."""
    objects: Float[Tensor, "batch frame slot width"]
    background: Float[Tensor, "batch frame width"] | None


class SlotKind(nn.Module):
    """Distribution and weights of slots that are alike."""

    mean: Tensor
    log_std: Tensor
    other_mean: Tensor
    other_log_std: Tensor
    noise: Tensor

    def __init__(self, config: SlotAttentionConfig, *, noise: Float[Tensor, "slot width"], weights: Weights):
        """There are as many slots as there is noise, that of evaluation."""
        super().__init__()
        width, self._learned = config.width, config.distribution == "learned"
        mean, log_std = _fresh(width), _fresh(width)
        if self._learned:
            self.mean, self.log_std = nn.Parameter(mean), nn.Parameter(log_std)
        else:
            other = torch.Generator().manual_seed(_EVALUATION_SEED)
            parts = {"mean": mean, "log_std": log_std, "other_mean": _fresh(width, other)}
            for name, part in (parts | {"other_log_std": _fresh(width, other)}).items():
                self.register_buffer(name, part, persistent=False)
        self.register_buffer("noise", noise)
        self.query = nn.Sequential(nn.LayerNorm(width), _linear(width, weights, gain=_QUERY_GAIN))
        self.value = _linear(width, weights)
        self.update = nn.GRUCell(width, width)
        self.refine = nn.Sequential(nn.LayerNorm(width), mlp(width, width, width))

    def first(self, batch: int, generator: torch.Generator | None) -> Float[Tensor, "batch slot width"]:
        """Slots before the first frame: mean + std * noise, in training with fresh noise."""
        shape = (batch, *self.noise.shape)
        if self.training:
            noise = torch.randn(shape, generator=generator, device=self.mean.device)
            return self.mean + self.log_std.exp() * noise
        if self._learned:
            return self.mean + self.log_std.exp() * self.noise.expand(shape)
        return self.other_mean + self.other_log_std.exp() * self.noise.expand(shape)

    def move(
        self, slots: Float[Tensor, "batch slot width"], updates: Float[Tensor, "batch slot width"]
    ) -> Float[Tensor, "batch slot width"]:
        """Slots after an iteration."""
        moved = self.update(updates.flatten(0, 1), slots.flatten(0, 1)).unflatten(0, slots.shape[:2])
        return moved + self.refine(moved)


class SlotAttention(nn.Module):
    """Slots compete for points, three times a frame."""

    def __init__(
        self,
        config: SlotAttentionConfig,
        *,
        features: int,
        slots: int,
        background: bool,
        weights: Weights = "orthogonal",
    ):
        """`slots` without the background's; `features` are those of a point."""
        super().__init__()
        width = config.width
        self.config = config
        self.position = nn.Linear(3 + 6 * config.position_frequencies, width, bias=False)
        self.features = mlp(features, width, width)
        self.tokens = nn.Sequential(nn.LayerNorm(width), mlp(width, width, width), nn.LayerNorm(width))
        self.key = _linear(width, weights, gain=_QUERY_GAIN)
        self.objects = SlotKind(config, noise=torch.randn(slots, width), weights=weights)
        self.background = None
        if background:
            self.background = SlotKind(config, noise=torch.zeros(1, width), weights=weights)

    def forward(
        self,
        points: Float[Tensor, "batch frame point 3"],
        valid: Bool[Tensor, "batch frame point"],
        features: Float[Tensor, "batch frame point feature"],
        *,
        generator: torch.Generator | None,
    ) -> Slots:
        """Slots and masks of all frames; `points` are -1..1 in the workspace."""
        tokens = self._tokens(points, features)
        keys, values = self.key(tokens), [kind.value(tokens) for kind in self._kinds()]
        slots = [kind.first(len(points), generator) for kind in self._kinds()]
        of_frames = []
        for frame in range(points.shape[1]):
            here = [value[:, frame] for value in values]
            slots, logits = self._settle(slots, keys[:, frame], here, valid[:, frame])
            of_frames.append((*slots, logits))
        *background, objects, logits = (torch.stack(parts, dim=1) for parts in zip(*of_frames, strict=True))
        masks = _masks(logits, valid, background=self.background is not None)
        return Slots(masks, objects, background[0][:, :, 0] if background else None)

    def _settle(
        self,
        slots: list[Float[Tensor, "batch _ width"]],
        keys: Float[Tensor, "batch point width"],
        values: list[Float[Tensor, "batch point width"]],
        valid: Bool[Tensor, "batch point"],
    ) -> tuple[list[Float[Tensor, "batch _ width"]], Float[Tensor, "batch component point"]]:
        """The slots of one frame, and the logits of their shares in the last iteration."""
        logits = self._logits(slots, keys)
        for left in reversed(range(self.config.iterations)):
            shares = _shares(logits, valid).split([own.shape[1] for own in slots], dim=1)
            updates = [share @ value for share, value in zip(shares, values, strict=True)]
            slots = [kind.move(own, update) for kind, own, update in zip(self._kinds(), slots, updates, strict=True)]
            if left:
                logits = self._logits(slots, keys)
        return slots, logits

    def _kinds(self) -> list[SlotKind]:
        """The background's first."""
        return [self.objects] if self.background is None else [self.background, self.objects]

    def _tokens(
        self, points: Float[Tensor, "batch frame point 3"], features: Float[Tensor, "batch frame point feature"]
    ) -> Float[Tensor, "batch frame point width"]:
        frequencies = self.config.position_frequencies
        position = torch.cat([points, positional_encoding(points, frequencies)], dim=-1)
        return self.tokens(self.features(features) + self.position(position))

    def _logits(
        self, slots: list[Float[Tensor, "batch _ width"]], keys: Float[Tensor, "batch point width"]
    ) -> Float[Tensor, "batch component point"]:
        queries = torch.cat([kind.query(own) for kind, own in zip(self._kinds(), slots, strict=True)], dim=1)
        return queries @ keys.mT * self.config.width**-0.5


def _shares(
    logits: Float[Tensor, "batch component point"], valid: Bool[Tensor, "batch point"]
) -> Float[Tensor, "batch component point"]:
    """Softmax over the slots, then normalised over the valid points."""
    shares = (logits.softmax(dim=1) + _LEAST_SHARE) * valid[:, None]
    return shares / shares.sum(dim=-1, keepdim=True).clamp(min=_LEAST_SHARE)


def _masks(
    logits: Float[Tensor, "batch frame component point"], valid: Bool[Tensor, "batch frame point"], *, background: bool
) -> Masks:
    """As of the IC-SBP: a background's mask comes first in any case, and has the points that are not valid."""
    there = rearrange(valid, "b f point -> b f 1 point")
    log_masks = logits.log_softmax(dim=2).masked_fill(~there, EXCLUDED)
    first = log_masks[:, :, :1] if background else torch.full_like(log_masks[:, :, :1], EXCLUDED)
    objects = log_masks[:, :, 1:] if background else log_masks
    return Masks(
        log_masks=torch.cat([first.masked_fill(~there, 0.0), objects], dim=2),
        log_scope=torch.full_like(valid, EXCLUDED, dtype=logits.dtype),
        active=torch.ones(objects.shape[0], objects.shape[2], dtype=torch.bool, device=valid.device),
    )


def _linear(width: int, weights: Weights, *, gain: float = 1.0) -> nn.Linear:
    layer = nn.Linear(width, width, bias=False)
    if weights == "orthogonal":
        pass_on(layer, gain=gain)
    return layer


def _fresh(width: int, generator: torch.Generator | None = None) -> Float[Tensor, " width"]:
    """Uniform as Glorot and Bengio (2010) have it, as in the authors' code."""
    bound = (6 / (1 + width)) ** 0.5
    return (2 * torch.rand(width, generator=generator) - 1) * bound
