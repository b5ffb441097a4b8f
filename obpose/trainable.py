"""Interface between models and `obpose.training.loop`, which trains all architectures."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from obpose.config import TrainConfig
from obpose.data.clips import ClipSource
from obpose.types import Observation, Segmentation


@runtime_checkable
class Configuration(Protocol):
    """All settings of a run, except for its data: a frozen dataclass of which the training reads `train`."""

    @property
    def train(self) -> TrainConfig:
        """Settings of the training."""
        ...


class Trainable(nn.Module, ABC):
    """Model that computes its own losses, which is all that the training needs."""

    observation_type: ClassVar[type[Observation]] = Observation
    """Input of a training step. Only models that declare `LabelledObservation` ever get labels."""

    @property
    def background_slot(self) -> int | None:
        """Label of the background; None if no label stands for it."""
        return 0

    def training_source(self, source: ClipSource) -> ClipSource:
        """Give the source of the clips of training steps, from that of the dataset's clips."""
        return source

    def check_source(self, source: ClipSource) -> None:
        """Check that the model can learn from a source that `training_source` gave; not called for validation clips.

        Raises:
            UsageError: it cannot; the message says what is expected.
        """

    def next_source(self, source: ClipSource, fraction: float) -> ClipSource:
        """Give the source of the steps from here on: `source` itself, unless training goes on with other data.

        Args:
            source: Source of the steps so far, by `training_source` or this method.
            fraction: Share of the budget that is used, 0 to 1.
        """
        return source

    def training_state(self) -> dict[str, Tensor]:
        """Give what only training needs, for checkpoints: tensors by name, besides weights and optimiser."""
        return {}

    def restore_training_state(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `training_state` gave, before `next_source` is called.

        Raises:
            UsageError: it does not fit the model.
        """

    def parameter_groups(self) -> list[tuple[list[nn.Parameter], float]]:
        """All parameters in their order, in groups, each with a factor of the learning rate."""
        return [([*self.parameters()], 1.0)]

    @abstractmethod
    def losses(
        self, observation: Observation, *, step: int, fraction: float, generator: torch.Generator | None
    ) -> dict[str, Tensor]:
        """Compute the loss terms by name: `total`, which is minimised, and the unweighted terms, for logs.

        Args:
            observation: Clips of the batch.
            step: Number of steps before this one.
            fraction: Share of the budget that is used, 0 to 1.
            generator: Source of all randomness.
        """

    @abstractmethod
    def segment(self, observation: Observation) -> Segmentation:
        """Label every pixel of whole clips, without randomness."""
