"""A flow from noise to objects: a distribution of whole objects, with all that their codes leave out.

An addition. It is a rectified flow (Liu, Gong and Liu 2023; Lipman et al. 2023) on the grids of objects that a model
found, and predicts, as in Li and He (2025), the object and not the velocity, which a network narrower than its input
cannot hold. No labels are used.
"""

import math

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn

from obpose.creation.grids import COLOUR_LIMIT, DENSITY_LIMIT, Grids
from obpose.nerf.detail import EDGE

PATCH = 8, 4, 4
"""Points of the grid along each edge of a token; most in depth, as the far side, which nobody saw, is plain."""
TOKENS = math.prod(EDGE // points for points in PATCH)
VALUES = 4 * math.prod(PATCH)
"""Of a token."""
WIDTH, DEPTH, HEADS = 192, 6, 6
TIME_MEAN, TIME_STD = -0.6, 0.9
"""Of the logit of the share of the object in what is looked at in training."""
LEAST_NOISE = 0.05
"""Where less of it is left, errors weigh no more: they are divided by the squared share of the noise."""
SIZE_WEIGHT = 0.05
"""Of the error of the size, beside that of a grid's values."""
SAMPLE_STEPS = 30
_FREQUENCIES = 16
_SLOWEST = 0.1
_FASTEST = 100.0
"""Of the sines that say the time, radians over all of it."""
_COLOUR_SCALE = 1.2
"""Logits of colours are divided by it, and those of density by their limit, to be about as large as the noise."""


class Flow(nn.Module):
    """A transformer over the patches of a noisy grid, with a token for its size.

    What enters a layer is scaled and shifted by the time.
    """

    code: Tensor
    size_mean: Tensor
    size_std: Tensor

    def __init__(self, latent: int) -> None:
        super().__init__()
        self.patch_in, self.patch_out = nn.Linear(VALUES, WIDTH), nn.Linear(WIDTH, VALUES)
        self.size_in, self.size_out = nn.Linear(1, WIDTH), nn.Linear(WIDTH, 1)
        self.position = nn.Parameter(0.02 * torch.randn(TOKENS + 1, WIDTH))
        self.time = nn.Sequential(nn.Linear(2 * _FREQUENCIES, WIDTH), nn.SiLU(), nn.Linear(WIDTH, WIDTH), nn.SiLU())
        self.modulation = nn.Linear(WIDTH, 2 * DEPTH * WIDTH)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)
        self.layers = nn.ModuleList(
            nn.TransformerEncoderLayer(WIDTH, HEADS, 4 * WIDTH, 0.0, "gelu", batch_first=True, norm_first=True)
            for _ in range(DEPTH)
        )
        self.norm = nn.LayerNorm(WIDTH)
        self.register_buffer("code", torch.zeros(latent))
        self.register_buffer("size_mean", torch.zeros(()))
        self.register_buffer("size_std", torch.ones(()))

    def forward(
        self, patches: Float[Tensor, "object patch value"], size: Float[Tensor, "object"], time: Float[Tensor, "object"]
    ) -> tuple[Float[Tensor, "object patch value"], Float[Tensor, "object"]]:
        """The object that is likely in `time` of it and the rest noise."""
        rates = torch.logspace(math.log10(_SLOWEST), math.log10(_FASTEST), _FREQUENCIES)
        angles = time[:, None] * rates
        modulation = self.modulation(self.time(torch.cat([angles.sin(), angles.cos()], dim=-1)))
        hidden = torch.cat([self.patch_in(patches), self.size_in(size[:, None])[:, None]], dim=1) + self.position
        for layer, change in zip(self.layers, modulation[:, None].chunk(DEPTH, dim=-1), strict=True):
            scale, shift = change.chunk(2, dim=-1)
            hidden = layer(hidden * (1 + scale) + shift)
        hidden = self.norm(hidden)
        return self.patch_out(hidden[:, :-1]), self.size_out(hidden[:, -1])[:, 0]

    def encode(self, grids: Grids) -> tuple[Float[Tensor, "object patch value"], Float[Tensor, "object"]]:
        """Grids as patches, and their sizes, both about as large as standard normal noise."""
        values = grids.values / grids.values.new_tensor([DENSITY_LIMIT] + 3 * [_COLOUR_SCALE])
        pattern = "object (i x) (j y) (k z) value -> object (i j k) (x y z value)"
        patches = rearrange(values, pattern, **_points_of_patch())
        return patches, (grids.half.log() - self.size_mean) / self.size_std

    def decode(self, patches: Float[Tensor, "object patch value"], size: Float[Tensor, "object"]) -> Grids:
        """The inverse of `encode`, within the limits of logits."""
        pattern = "object (i j k) (x y z value) -> object (i x) (j y) (k z) value"
        number = {axis: EDGE // points for axis, points in zip("ijk", PATCH, strict=True)}
        values = rearrange(patches, pattern, **number, **_points_of_patch())
        limits = values.new_tensor([DENSITY_LIMIT] + 3 * [COLOUR_LIMIT])
        values = values * values.new_tensor([DENSITY_LIMIT] + 3 * [_COLOUR_SCALE])
        return Grids(values.clamp(-limits, limits), (size * self.size_std + self.size_mean).exp())


def describe(flow: Flow, grids: Grids, what: Float[Tensor, "object what"]) -> None:
    """Keep the mean code and the distribution of sizes of the objects that a flow is to learn."""
    flow.code.copy_(what.mean(dim=0))
    flow.size_mean.copy_(grids.half.log().mean())
    flow.size_std.copy_(grids.half.log().std().clamp(min=1e-3))


def flow_loss(flow: Flow, grids: Grids, noise: torch.Generator) -> Float[Tensor, ""]:
    """Mean squared error of the velocity from noise to objects (rectified flow), at one time for each object."""
    patches, size = flow.encode(grids)
    time = torch.sigmoid(torch.randn(len(size), generator=noise) * TIME_STD + TIME_MEAN)
    share = time[:, None, None]
    noisy = share * patches + (1 - share) * torch.randn(patches.shape, generator=noise)
    noisy_size = time * size + (1 - time) * torch.randn(size.shape, generator=noise)
    found, found_size = flow(noisy, noisy_size, time)
    weight = (1 - time).clamp(min=LEAST_NOISE) ** -2
    errors = (found.float() - patches).square().mean(dim=(1, 2)) + SIZE_WEIGHT * (found_size.float() - size).square()
    return (weight * errors).mean()


@torch.no_grad()
def sample_grids(flow: Flow, count: int, generator: torch.Generator) -> Grids:
    """Objects from noise, by Heun's method."""
    if count == 0:
        return Grids(flow.code.new_zeros(0, EDGE, EDGE, EDGE, 4), flow.code.new_zeros(0))
    state = torch.randn(count, TOKENS * VALUES + 1, generator=generator)

    def velocity(state: Float[Tensor, "object value"], time: float) -> Float[Tensor, "object value"]:
        patches = state[:, :-1].unflatten(1, (TOKENS, VALUES))
        found, size = flow(patches, state[:, -1], torch.full((count,), time))
        return (torch.cat([found.flatten(1), size[:, None]], dim=1) - state) / (1 - time)

    step = 1 / SAMPLE_STEPS
    for place in range(SAMPLE_STEPS):
        first = velocity(state, place * step)
        ahead = state + step * first
        last = place == SAMPLE_STEPS - 1
        state = ahead if last else state + step / 2 * (first + velocity(ahead, (place + 1) * step))
    return flow.decode(state[:, :-1].unflatten(1, (TOKENS, VALUES)), state[:, -1])


def _points_of_patch() -> dict[str, int]:
    return dict(zip("xyz", PATCH, strict=True))


def mirrored(grids: Grids, which: Float[Tensor, "object"]) -> Grids:
    """Left and right exchanged where `which` is 1, which leaves an object's place, and what is up, as they are."""
    swap = (which > 0.5)[:, None, None, None, None]
    return Grids(torch.where(swap, grids.values.flip(2), grids.values), grids.half)
