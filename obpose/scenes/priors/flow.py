"""A flow from noise to objects: a distribution of whole objects with their details.

Not in the paper. It is a rectified flow (Liu, Gong and Liu 2023; Lipman et al. 2023) on the principal components of
grids of objects that a model found. As in Li and He (2025), it predicts the object instead of the velocity. Components
describe whole grids, so that the parts of a sampled object fit together. No labels are used.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from obpose.model.nerf.detail import EDGE
from obpose.scenes.priors.grids import COLOUR_LIMIT, DENSITY_LIMIT, Grids, mean_colour

_ITERATIONS = 4
"""Iterations of the randomised SVD; more make no visible difference."""
_SPARE = 8
"""Extra axes of the randomised SVD, because the last ones are inaccurate."""


class Components(nn.Module):
    """Mean and principal axes of vectors. Before `fit`, the mean and all axes are 0.

    Coefficients are divided by one common scale, such that their mean square over vectors and axes is 1. Axes with more
    variance keep their weight.
    """

    mean: Float[Tensor, " size"]
    axes: Float[Tensor, "size count"]
    """Unit vectors; zero vectors beyond the rank of the data."""
    scale: Float[Tensor, ""]

    def __init__(self, size: int, count: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("axes", torch.zeros(size, count))
        self.register_buffer("scale", torch.ones(()))

    def fit(self, vectors: Float[Tensor, "n size"]) -> None:
        """Compute the mean and the axes of vectors; the result depends only on the vectors and their order."""
        size, count = self.axes.shape
        self.mean.copy_(vectors.mean(dim=0))
        most = min(count + _SPARE, len(vectors), size)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            _, lengths, axes = torch.svd_lowrank(vectors - self.mean, q=most, niter=_ITERATIONS)
        kept = min(count, int((lengths > 1e-5 * vectors.norm()).sum()))
        self.axes.zero_()
        self.axes[:, :kept] = axes[:, :kept]
        self.scale.copy_((lengths[:kept].square().sum() / (len(vectors) * kept)).sqrt() if kept else torch.ones(()))

    def encode(self, vectors: Float[Tensor, "n size"]) -> Float[Tensor, "n count"]:
        """Compute the coefficients along the axes."""
        return (vectors - self.mean) @ self.axes / self.scale

    def decode(self, numbers: Float[Tensor, "n count"]) -> Float[Tensor, "n size"]:
        """Reconstruct vectors from their coefficients."""
        return self.mean + (numbers * self.scale) @ self.axes.T


SHAPES, COLOURS = 128, 64
"""Number of components of densities, and of differences of colours from the object's mean colour."""
PLAIN = 4
"""Number of values that are not compressed: the mean colour and the size."""
VALUES = SHAPES + COLOURS + PLAIN
"""Number of values that describe an object."""
WIDTH, DEPTH, TIME_WIDTH = 384, 5, 128
DROPOUT = 0.1
TIME_MEAN, TIME_STD = -0.4, 1.0
"""Mean and standard deviation of the logit of the training times."""
LEAST_NOISE = 0.1
"""Lower limit of the share of noise in the weights of errors, which are divided by its square."""
PLAIN_WEIGHT = 8.0
"""Weight of the errors of mean colour and size, relative to those of the many components."""
SAMPLE_STEPS = 40
_FREQUENCIES = 16
_SLOWEST = 0.1
_FASTEST = 100.0
"""Frequencies of the encoding of time, radians per unit of time."""


class Layer(nn.Module):
    """Residual layer; time scales and shifts its input, and scales its output."""

    def __init__(self) -> None:
        super().__init__()
        self.inner, self.outer = nn.Linear(WIDTH, WIDTH), nn.Linear(WIDTH, WIDTH)
        self.drop = nn.Dropout(DROPOUT)
        self.modulation = nn.Linear(TIME_WIDTH, 3 * WIDTH)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)

    def forward(
        self, hidden: Float[Tensor, "object width"], time: Float[Tensor, "object time"]
    ) -> Float[Tensor, "object width"]:
        """Compute the hidden values of the next layer."""
        scale, shift, gate = self.modulation(time).chunk(3, dim=-1)
        entered = F.layer_norm(hidden, hidden.shape[-1:]) * (1 + scale) + shift
        return hidden + (1 + gate) * self.outer(self.drop(F.gelu(self.inner(entered))))


class Flow(nn.Module):
    """Compression of objects to few values, and a network that denoises them."""

    code: Float[Tensor, "what"]
    """Code of sampled objects: the mean of z_what."""
    plain_mean: Float[Tensor, "4"]
    plain_std: Float[Tensor, "4"]

    def __init__(self, latent: int) -> None:
        super().__init__()
        self.shapes, self.colours = Components(EDGE**3, SHAPES), Components(3 * EDGE**3, COLOURS)
        self.enter, self.leave = nn.Linear(VALUES, WIDTH), nn.Linear(WIDTH, VALUES)
        self.time = nn.Sequential(
            nn.Linear(2 * _FREQUENCIES, TIME_WIDTH), nn.SiLU(), nn.Linear(TIME_WIDTH, TIME_WIDTH), nn.SiLU()
        )
        self.layers = nn.ModuleList(Layer() for _ in range(DEPTH))
        self.norm = nn.LayerNorm(WIDTH)
        self.register_buffer("code", torch.zeros(latent))
        self.register_buffer("plain_mean", torch.zeros(PLAIN))
        self.register_buffer("plain_std", torch.ones(PLAIN))

    def forward(
        self, noisy: Float[Tensor, "object value"], time: Float[Tensor, "object"]
    ) -> Float[Tensor, "object value"]:
        """Predict objects from a mixture of noise and a share `time` of the object."""
        rates = torch.logspace(math.log10(_SLOWEST), math.log10(_FASTEST), _FREQUENCIES)
        angles = time[:, None] * rates
        when = self.time(torch.cat([angles.sin(), angles.cos()], dim=-1))
        hidden = self.enter(noisy)
        for layer in self.layers:
            hidden = layer(hidden, when)
        return self.leave(self.norm(hidden))

    def encode(self, grids: Grids) -> Float[Tensor, "object value"]:
        """Compress grids to values of about unit variance."""
        density, colour, plain = _apart(grids)
        return torch.cat(
            [self.shapes.encode(density), self.colours.encode(colour), (plain - self.plain_mean) / self.plain_std],
            dim=1,
        )

    def decode(self, values: Float[Tensor, "object value"]) -> Grids:
        """Reconstruct grids from values, within the limits of logits."""
        shape, colour, plain = values.split([SHAPES, COLOURS, PLAIN], dim=1)
        plain = plain * self.plain_std + self.plain_mean
        density = self.shapes.decode(shape).view(-1, EDGE, EDGE, EDGE, 1)
        colour = self.colours.decode(colour).view(-1, EDGE, EDGE, EDGE, 3) + plain[:, None, None, None, :3]
        limits = values.new_tensor([DENSITY_LIMIT] + 3 * [COLOUR_LIMIT])
        return Grids(torch.cat([density, colour], dim=-1).clamp(-limits, limits), plain[:, 3].exp())


def _apart(
    grids: Grids,
) -> tuple[Float[Tensor, "object density"], Float[Tensor, "object colour"], Float[Tensor, "object 4"]]:
    """Split grids into densities, differences from the mean colour, and the mean colour with the log of the size."""
    density, colour = grids.values[..., :1], grids.values[..., 1:]
    mean = mean_colour(density, colour)
    difference = colour - mean[:, None, None, None]
    return density.flatten(1), difference.flatten(1), torch.cat([mean, grids.half.log()[:, None]], dim=1)


def describe(flow: Flow, grids: Grids, what: Float[Tensor, "object what"]) -> None:
    """Set the statistics of a flow from its training objects: components, mean code, colours and sizes."""
    density, colour, plain = _apart(grids)
    flow.shapes.fit(density)
    flow.colours.fit(colour)
    flow.plain_mean.copy_(plain.mean(dim=0))
    flow.plain_std.copy_(plain.std(dim=0).clamp(min=1e-3))
    flow.code.copy_(what.mean(dim=0))


def flow_loss(flow: Flow, objects: Float[Tensor, "object value"], noise: torch.Generator) -> Float[Tensor, ""]:
    """Compute the mean squared error of the velocity (rectified flow) at one random time for each encoded object."""
    time = torch.sigmoid(torch.randn(len(objects), generator=noise) * TIME_STD + TIME_MEAN)
    share = time[:, None]
    noisy = share * objects + (1 - share) * torch.randn(objects.shape, generator=noise)
    errors = (flow(noisy, time) - objects).square()
    weights = torch.cat([errors.new_ones(VALUES - PLAIN), errors.new_full((PLAIN,), PLAIN_WEIGHT)])
    return ((1 - share).clamp(min=LEAST_NOISE) ** -2 * errors * weights).mean()


@torch.no_grad()
def sample_grids(flow: Flow, count: int, generator: torch.Generator) -> Grids:
    """Integrate the flow from noise to objects by Heun's method."""
    state = torch.randn(count, VALUES, generator=generator)

    def velocity(state: Float[Tensor, "object value"], time: float) -> Float[Tensor, "object value"]:
        return (flow(state, torch.full((count,), time)) - state) / (1 - time)

    step = 1 / SAMPLE_STEPS
    for place in range(SAMPLE_STEPS):
        first = velocity(state, place * step)
        ahead = state + step * first
        last = place == SAMPLE_STEPS - 1
        state = ahead if last else state + step / 2 * (first + velocity(ahead, (place + 1) * step))
    return flow.decode(state)


def mirrored(grids: Grids) -> Grids:
    """Mirror grids left to right."""
    return Grids(grids.values.flip(2), grids.half)
