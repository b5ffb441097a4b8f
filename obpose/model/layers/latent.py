"""Latents of a clip: a recurrent posterior over codes, and a recurrent prior over earlier latents.

Paper, section Object Location and Orientation Conditioned Encoding: q(z_t | x_<=t) and p(z_t | z_<t), each a GRU whose
hidden state an MLP turns into a diagonal Gaussian.
"""

import math
from typing import Literal

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import softplus

from obpose.config import LatentConfig, Weights
from obpose.model.layers.mlp import mlp, pass_on
from obpose.types import Draw, Latent

Values = Float[Tensor, "*shape latent"]

Start = Literal["zero", "learned"]
"""Hidden states before the first frame. `zero`: zeros, and the first prior is N(0, 1); `learned`: parameters, from
which the first prior is computed, too."""

LATENT = 32
"""Dimensions of z_where, z_what and z_bg. [code]"""
HIDDEN = 32
"""Width of the recurrent cells. [code]"""
PRIOR_STD = 0.7
"""Typical standard deviation of the prior before training. [code]"""
_MEAN_GAIN = 3.0
"""Gain of the layer of the posterior's mean, so that scenes initially differ about as much as the prior varies."""


class RecurrentLatent(nn.Module):
    """Module that maps a sequence of codes to a sequence of latents and their priors.

    As in the authors' code, earlier latents reach the posterior only through the codes that they influence (the paper's
    q(z_what) is also conditioned on earlier z). So the posteriors of all frames are computed and drawn at once.

    Additions: the posterior's MLP gets the code of the frame beside the normalised hidden state, because a fresh GRU
    passes on only a tenth of what distinguishes two scenes. A fresh posterior is narrow, because the noise of a wide
    one would drown a fresh code.
    """

    def __init__(
        self,
        code: int,
        config: LatentConfig,
        *,
        weights: Weights = "orthogonal",
        start: Start = "zero",
        latent: int = LATENT,
        hidden: int = HIDDEN,
    ):
        """Initialise the weights, for codes with `code` channels."""
        super().__init__()
        # Posterior: a GRU over codes, and an MLP to mean and spread.
        self._std = config.posterior_std
        self._posterior = nn.GRU(code, hidden)
        beside = config.posterior_input == "state and code"
        self._posterior_norm = nn.LayerNorm(hidden) if beside else None
        first, last = nn.Linear(hidden + beside * code, hidden), nn.Linear(hidden, 2 * latent)
        if weights == "orthogonal":
            pass_on(first)
            pass_on(last, gain=_MEAN_GAIN, outputs=latent)
        self._posterior_head = nn.Sequential(first, nn.ELU(), last)
        # Prior: a GRU over latents, likewise.
        self._prior = nn.GRU(latent, hidden)
        self._prior_head = mlp(hidden, hidden, 2 * latent)
        self._starts = nn.Parameter(torch.zeros(2, hidden)) if start == "learned" else None

    def forward(
        self, code: Float[Tensor, "batch frame *slot code"], draw: Draw, generator: torch.Generator | None = None
    ) -> Latent:
        """Latents of all frames; frames are steps of the recurrence, and every slot is a separate sequence."""
        batch, _, *slots, _ = code.shape
        sequence = rearrange(code, "batch frame ... code -> frame (batch ...) code")
        posterior_start, prior_start = self._hidden(sequence)
        # Posteriors q(z_t | x_<=t).
        hidden, _ = self._posterior(sequence, posterior_start)
        if self._posterior_norm is not None:
            hidden = torch.cat([self._posterior_norm(hidden), sequence], dim=-1)
        mean, std = mean_and_std(self._posterior_head(hidden), typical_std=self._std)
        z = draw_gaussian(mean, std, draw=draw, generator=generator)
        # Priors p(z_t | z_<t).
        parts = (z, mean, std, *self._priors(z, prior_start))
        unfolded = (part.reshape(len(part), batch, *slots, part.shape[-1]) for part in parts)
        return Latent(*(rearrange(part, "f b ... z -> b f ... z") for part in unfolded))

    @torch.no_grad()
    def first(self) -> tuple[Float[Tensor, "latent"], Float[Tensor, "latent"]]:
        """Mean and standard deviation of the prior of the first frame."""
        empty = next(self.parameters()).new_zeros(1, 1, self._posterior.input_size)
        latent = self._prior.input_size
        mean, std = self._priors(empty.new_zeros(1, 1, latent), self._hidden(empty)[1])
        return mean[0, 0], std[0, 0]

    def _hidden(self, sequence: Tensor) -> tuple[Tensor, Tensor]:
        """Hidden states of posterior and prior before the first frame."""
        count = sequence.shape[1]
        if self._starts is None:
            zeros = sequence.new_zeros(1, count, self._posterior.hidden_size)
            return zeros, zeros
        posterior, prior = self._starts[:, None, None].expand(-1, 1, count, -1).contiguous()
        return posterior, prior

    def _priors(self, z: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
        """Means and standard deviations of the priors of all frames."""
        # The first prior is N(0, 1), or that of the learned state.
        first = self._prior_head(start) if self._starts is not None else None
        later = self._prior(z[:-1], start)[0] if len(z) > 1 else z.new_zeros(0, z.shape[1], start.shape[-1])
        mean, std = mean_and_std(self._prior_head(later), typical_std=PRIOR_STD)
        if first is None:
            return torch.cat([torch.zeros_like(z[:1]), mean]), torch.cat([torch.ones_like(z[:1]), std])
        first_mean, first_std = mean_and_std(first, typical_std=PRIOR_STD)
        return torch.cat([first_mean, mean]), torch.cat([first_std, std])


SMALLEST_STD = 1e-4
"""Smallest standard deviation, which keeps divergences finite."""


def mean_and_std(parameters: Float[Tensor, "*shape twice"], *, typical_std: float) -> tuple[Values, Values]:
    """Mean and standard deviation from the output of a network; they are 0 and `typical_std` for an output of 0.

    The first half of the output is the mean, the other half goes through a shifted softplus. The authors' is not
    shifted, so that 0.7 is typical.
    """
    mean, spread = parameters.chunk(2, dim=-1)
    shift = math.log(math.expm1(typical_std))
    return mean, softplus(spread + shift) + SMALLEST_STD


def draw_gaussian(mean: Values, std: Values, *, draw: Draw, generator: torch.Generator | None) -> Values:
    """Draw a reparametrised sample, mean + std * noise, or give the mean."""
    if draw == "mean":
        return mean
    noise = torch.randn(mean.shape, generator=generator, device=mean.device, dtype=mean.dtype)
    return mean + std * noise
