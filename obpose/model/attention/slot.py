"""Slot attention over the points of a clip (Locatello et al. 2020; the paper's ablation instead of the IC-SBP).

Object slots share their distribution and all weights. The background's slot has its own, except for the keys, as in the
authors' code. Slots of a frame start from those of the frame before.

In training the first slots are samples through which gradients reach the distribution. In the authors' code they do not
reach it, and the distribution is neither learned nor saved. Evaluation must not be random, but equal slots would stay
equal: the noise of the object slots is drawn once and saved with the weights. The background slot starts at its mean.
"""

import torch
from einops import rearrange
from jaxtyping import Bool, Float
from torch import Tensor, nn

from obpose.config import ModelConfig, Weights
from obpose.model.attention.interface import EXCLUDED, Attended, Attention, mean_under
from obpose.model.layers.mlp import mlp, pass_on
from obpose.model.nerf.field import positional_encoding
from obpose.types import ComponentMasks, Embeddings, GridValid, Masks

ITERATIONS = 3
"""Iterations in each frame. [code]"""
WIDTH = 32
"""Channels of a slot. [code]"""
POSITION_FREQUENCIES = 1
"""Number of frequencies: tokens get sin and cos of 2^i pi p, for i below this, beside position p. [ours; code: 0]"""
_EPSILON = 1e-8
"""Value added to the attention before it is normalised over tokens, as in the paper of slot attention."""
_QUERY_GAIN = 2.0
"""Gain of orthogonal queries and keys, with which slots divide the points from the start. With PyTorch's own weights,
all slots get nearly the same share of every point, and so nearly the same codes."""
_EVALUATION_SEED = 0
"""Seed of the untrained distribution at evaluation."""


class SlotKind(nn.Module):
    """Distribution and weights of one kind of slots: of the objects, or of the background."""

    mean: Tensor
    log_std: Tensor
    other_mean: Tensor
    other_log_std: Tensor
    noise: Tensor

    def __init__(self, *, noise: Float[Tensor, "slot width"], learned: bool, weights: Weights):
        """Initialise the weights; `noise` is that of evaluation, a row for each slot."""
        super().__init__()
        width, self._learned = noise.shape[-1], learned
        # Distribution of the first slots.
        mean, log_std = _glorot(width), _glorot(width)
        if learned:
            self.mean, self.log_std = nn.Parameter(mean), nn.Parameter(log_std)
        else:
            other = torch.Generator().manual_seed(_EVALUATION_SEED)
            parts = {"mean": mean, "log_std": log_std, "other_mean": _glorot(width, other)}
            for name, part in (parts | {"other_log_std": _glorot(width, other)}).items():
                self.register_buffer(name, part, persistent=False)
        self.register_buffer("noise", noise)
        # Attention, recurrent update and residual MLP (Locatello et al. 2020, algorithm 1).
        self.query = nn.Sequential(nn.LayerNorm(width), _linear(width, weights, gain=_QUERY_GAIN))
        self.value = _linear(width, weights)
        self.update = nn.GRUCell(width, width)
        self.refine = nn.Sequential(nn.LayerNorm(width), mlp(width, width, width))

    def first(self, batch: int, generator: torch.Generator | None) -> Float[Tensor, "batch slot width"]:
        """Slots before the first frame: mean + std * noise, with fresh noise in training."""
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


class SlotAttention(Attention):
    """Slots that compete for points, in a few iterations per frame."""

    def __init__(self, config: ModelConfig, *, features: int, width: int = WIDTH, iterations: int = ITERATIONS):
        """Initialise the weights, for points with `features` channels."""
        super().__init__()
        self._iterations, self._width, self._appends_means = iterations, width, config.latent.means == "given"
        self.size = width + (features + 3 if self._appends_means else 0)
        kind = {"learned": config.attention.slot_distribution == "learned", "weights": config.weights}
        # Tokens from features and positions of points, and their keys.
        self.position = nn.Linear(3 + 6 * POSITION_FREQUENCIES, width, bias=False)
        self.features = mlp(features, width, width)
        self.tokens = nn.Sequential(nn.LayerNorm(width), mlp(width, width, width), nn.LayerNorm(width))
        self.key = _linear(width, config.weights, gain=_QUERY_GAIN)
        # Slots: the objects share one distribution, the background has its own.
        self.objects = SlotKind(noise=torch.randn(config.object_components, width), **kind)
        self.background = SlotKind(noise=torch.zeros(1, width), **kind) if config.has_background else None

    def forward(self, embeddings: Embeddings, generator: torch.Generator | None) -> Attended:
        """Slots and masks of all frames; masks are those of the last iteration and leave no scope."""
        # Tokens, keys and values of all frames.
        encoded = positional_encoding(embeddings.position, POSITION_FREQUENCIES)
        position = self.position(torch.cat([embeddings.position, encoded], dim=-1))
        tokens = self.tokens(self.features(embeddings.features) + position)
        keys, values = self.key(tokens), [kind.value(tokens) for kind in self._kinds()]
        # Slots, frame by frame.
        slots = [kind.first(len(tokens), generator) for kind in self._kinds()]
        of_frames = []
        for frame in range(tokens.shape[1]):
            here = [value[:, frame] for value in values]
            slots, logits = self._iterate(slots, keys[:, frame], here, embeddings.valid[:, frame])
            of_frames.append((*slots, logits))
        *background, objects, logits = (torch.stack(parts, dim=1) for parts in zip(*of_frames, strict=True))
        masks = _masks(logits, embeddings.valid, background=self.background is not None)
        background_code = background[0][:, :, 0] if background else None
        # An addition: the mean of features and position under a slot's mask ends its code.
        if self._appends_means:
            found = torch.cat([embeddings.features, embeddings.position], dim=-1)
            means = mean_under(masks.log_masks, embeddings.valid, found)
            objects = torch.cat([objects, means[:, :, 1:]], dim=-1)
            if background_code is not None:
                background_code = torch.cat([background_code, means[:, :, 0]], dim=-1)
        return Attended(masks, objects, background_code)

    def background_code(self, embeddings: Embeddings, generator: torch.Generator | None) -> Tensor:
        """Code of the background's slot."""
        code = self(embeddings, generator).background_code
        assert code is not None
        return code

    def _iterate(
        self,
        slots: list[Float[Tensor, "batch _ width"]],
        keys: Float[Tensor, "batch point width"],
        values: list[Float[Tensor, "batch point width"]],
        valid: Bool[Tensor, "batch point"],
    ) -> tuple[list[Float[Tensor, "batch _ width"]], Float[Tensor, "batch component point"]]:
        """Compute the slots of one frame, and the attention logits of the last iteration."""
        logits = self._logits(slots, keys)
        for left in reversed(range(self._iterations)):
            # Softmax over the slots, then a mean over the valid points (Locatello et al. 2020, eq. 1 and 2).
            attention = (logits.softmax(dim=1) + _EPSILON) * valid[:, None]
            attention = attention / attention.sum(dim=-1, keepdim=True).clamp(min=_EPSILON)
            parts = attention.split([own.shape[1] for own in slots], dim=1)
            # Each kind of slots has its own values and weights.
            updates = [part @ value for part, value in zip(parts, values, strict=True)]
            slots = [kind.move(own, update) for kind, own, update in zip(self._kinds(), slots, updates, strict=True)]
            if left:
                logits = self._logits(slots, keys)
        return slots, logits

    def _kinds(self) -> list[SlotKind]:
        """Kinds of slots, the background first."""
        return [self.objects] if self.background is None else [self.background, self.objects]

    def _logits(
        self, slots: list[Float[Tensor, "batch _ width"]], keys: Float[Tensor, "batch point width"]
    ) -> Float[Tensor, "batch component point"]:
        queries = torch.cat([kind.query(own) for kind, own in zip(self._kinds(), slots, strict=True)], dim=1)
        return queries @ keys.mT * self._width**-0.5


def _masks(logits: ComponentMasks, valid: GridValid, *, background: bool) -> Masks:
    """Masks like those of the IC-SBP: the background comes first in any case, and has the invalid points."""
    there = rearrange(valid, "b f point -> b f 1 point")
    log_masks = logits.log_softmax(dim=2).masked_fill(~there, EXCLUDED)
    # Without a background slot, its mask holds the invalid points only.
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


def _glorot(width: int, generator: torch.Generator | None = None) -> Float[Tensor, " width"]:
    """Draw uniformly as in Glorot and Bengio (2010), as in the authors' code."""
    bound = (6 / (1 + width)) ** 0.5
    return (2 * torch.rand(width, generator=generator) - 1) * bound
