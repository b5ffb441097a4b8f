"""One step of learning: losses, gradients, their norm, Adam."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from obpose.checkpoint import Build, TrainingState, put_weights
from obpose.clips import views_apart
from obpose.errors import UsageError
from obpose.optimizer_state import optimizer_state, put_optimizer_state
from obpose.tensors import State
from obpose.trainable import Configuration, Trainable
from obpose.training.budget import is_skipped
from obpose.training.devices import mean_over_processes, noise_of
from obpose.training.guard import check_finite


@dataclass(frozen=True)
class Learned:
    """What a step was like."""

    losses: dict[str, float]
    """Means over all processes."""
    gradient_norm: float
    """Before clipping."""


class Learner:
    """A model and its optimiser."""

    def __init__(self, fabric: Fabric, config: Configuration, build: Build):
        """Fresh weights follow from the seed."""
        self._fabric, self._config = fabric, config.train
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.train.seed)
            self.model: Trainable = build(config)
        optimizer = torch.optim.Adam(self.model.parameters(), lr=config.train.learning_rate, fused=True)
        self._module, self._optimizer = fabric.setup(_Losses(self.model, config), optimizer)

    def learn(self, batch: Mapping[str, Tensor], *, step: int, fraction: float, learning_rate: float) -> Learned:
        """Make one step, at a fraction of the budget.

        Raises:
            Diverged: losses or gradients are not finite; the weights are as before.
        """
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate
        self._optimizer.zero_grad()
        device = self._fabric.device
        tensors = {name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()}
        noise = noise_of(step, seed=self._config.seed, process=self._fabric.global_rank, device=device)
        terms: dict[str, Tensor] = self._module(tensors, step=step, fraction=fraction, generator=noise)
        self._fabric.backward(terms["total"])
        norm = self._clip()
        values = torch.stack([term.detach().float() for term in terms.values()])
        *losses, gradient_norm = torch.cat([mean_over_processes(self._fabric, values), norm[None]]).tolist()
        learned = Learned(dict(zip(terms, losses, strict=True)), gradient_norm)
        check_finite(learned.losses, gradient_norm, self.model.named_parameters(), step=step + 1)
        if not is_skipped(self._config, fraction, gradient_norm):
            self._optimizer.step()
        return learned

    def weights(self) -> State:
        """Of the model, for a checkpoint."""
        return self.model.state_dict()

    def optimizer_state(self) -> State:
        """`parameter.value` to tensor; parameters that had no gradient yet have none."""
        return optimizer_state(self.model, self._optimizer)

    def restore(self, state: TrainingState) -> None:
        """Go on from a checkpoint.

        Raises:
            UsageError: its weights or its optimiser's state are another model's.
        """
        put_weights(self.model, state.weights, "the checkpoint")
        try:
            put_optimizer_state(self.model, self._optimizer, state.optimizer)
        except ValueError as error:
            raise UsageError(
                f"The checkpoint's state of the optimiser does not fit the model of this version: {error}. Begin anew "
                "in another folder with --out."
            ) from None

    def _clip(self) -> Tensor:
        """Clip the gradient and give its norm; an infinite limit only measures."""
        norm = self._fabric.clip_gradients(
            self._module, self._optimizer, max_norm=self._config.clip or math.inf, error_if_nonfinite=False
        )
        assert norm is not None
        return norm


class _Losses(nn.Module):
    """A model's losses as a forward pass, which is where data-parallel training hooks in."""

    def __init__(self, model: Trainable, config: Configuration):
        super().__init__()
        self.model = model
        self._views = config.train.views

    def forward(
        self, tensors: Mapping[str, Tensor], *, step: int, fraction: float, generator: torch.Generator
    ) -> dict[str, Tensor]:
        observation = self.model.sees(**tensors)
        if self._views == "apart":
            observation = views_apart(observation)
        return self.model.losses(observation, step=step, fraction=fraction, generator=generator)
