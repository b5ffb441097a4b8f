"""One training step: losses, gradients, clipping, Adam."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from obpose.data.clips import separate_views
from obpose.errors import UsageError
from obpose.storage.checkpoint import Build, Info, TrainingState, put_weights
from obpose.storage.optimizer_state import optimizer_state, put_optimizer_state
from obpose.storage.tensors import State
from obpose.trainable import Configuration, Trainable
from obpose.training.devices import mean_over_processes, noise_of
from obpose.training.guard import check_finite


@dataclass(frozen=True)
class StepResult:
    """Losses and gradient norm of a step."""

    losses: dict[str, float]
    """Means over all processes."""
    gradient_norm: float
    """Norm of the gradient before clipping."""


class Learner:
    """A model and its optimiser."""

    def __init__(self, fabric: Fabric, config: Configuration, build: Build):
        """Build the model and its optimiser; initial weights depend on the seed."""
        self._fabric, self._config = fabric, config.train
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.train.seed)
            self.model: Trainable = build(config)
        groups = [{"params": params, "factor": factor} for params, factor in self.model.parameter_groups()]
        optimizer = torch.optim.Adam(groups, lr=config.train.learning_rate, fused=True)
        self._module, self._optimizer = fabric.setup(_Losses(self.model, config), optimizer)

    def step(self, batch: Mapping[str, Tensor], *, step: int, fraction: float, learning_rate: float) -> StepResult:
        """Take one step; `fraction` is the used share of the budget.

        Raises:
            Diverged: losses or gradients are not finite; the weights are unchanged.
        """
        for group in self._optimizer.param_groups:
            group["lr"] = learning_rate * group["factor"]
        self._optimizer.zero_grad()
        device = self._fabric.device
        tensors = {name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()}
        noise = noise_of(step, seed=self._config.seed, process=self._fabric.global_rank, device=device)
        terms: dict[str, Tensor] = self._module(tensors, step=step, fraction=fraction, generator=noise)
        self._fabric.backward(terms["total"])
        norm = self._clip()
        values = torch.stack([term.detach().float() for term in terms.values()])
        *losses, gradient_norm = torch.cat([mean_over_processes(self._fabric, values), norm[None]]).tolist()
        result = StepResult(dict(zip(terms, losses, strict=True)), gradient_norm)
        # Check before the weights change.
        check_finite(result.losses, gradient_norm, self.model.named_parameters(), step=step + 1)
        self._optimizer.step()
        return result

    def weights(self) -> State:
        """Give the weights of the model, for a checkpoint."""
        return self.model.state_dict()

    def optimizer_state(self) -> State:
        """Give the optimiser state by key `parameter.value`, without parameters that had no gradient yet."""
        return optimizer_state(self.model, self._optimizer)

    def state(self, info: Info) -> TrainingState:
        """Give the state of the training, for a checkpoint."""
        return TrainingState(self.weights(), self.optimizer_state(), info, self.model.training_state())

    def restore(self, state: TrainingState) -> None:
        """Restore the state of a training from a checkpoint.

        Raises:
            UsageError: it does not fit the model.
        """
        put_weights(self.model, state.weights, "the checkpoint")
        self.model.restore_training_state(state.extra)
        try:
            put_optimizer_state(self.model, self._optimizer, state.optimizer)
        except ValueError as error:
            raise UsageError(
                f"The checkpoint's state of the optimiser does not fit the model of this version: {error}. Begin anew "
                "in another folder with --out."
            ) from None

    def close(self) -> None:
        """Drop the optimiser and the wrapper for data-parallel training; the model stays.

        The wrapper holds the process group. If it were the last to do so, freeing it could wait forever for a thread
        of gloo that waits for the interpreter's lock.
        """
        del self._module, self._optimizer

    def _clip(self) -> Tensor:
        """Clip the gradient and give its norm before clipping; a limit of 0 only measures."""
        norm = self._fabric.clip_gradients(
            self._module, self._optimizer, max_norm=self._config.clip or math.inf, error_if_nonfinite=False
        )
        assert norm is not None
        return norm


class _Losses(nn.Module):
    """Wrap a model's losses as a forward pass, which data-parallel training requires."""

    def __init__(self, model: Trainable, config: Configuration):
        super().__init__()
        self.model = model
        self._views = config.train.views

    def forward(
        self, tensors: Mapping[str, Tensor], *, step: int, fraction: float, generator: torch.Generator
    ) -> dict[str, Tensor]:
        observation = self.model.observation_type(**tensors)
        if self._views == "separate":
            observation = separate_views(observation)
        return self.model.losses(observation, step=step, fraction=fraction, generator=generator)
