"""What `obpose.training.loop` asks of a model, so that other architectures are trained by the same loop."""

from abc import ABC, abstractmethod
from typing import ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from obpose.config import TrainConfig
from obpose.types import Observation, Segmentation


@runtime_checkable
class Configuration(Protocol):
    """Everything that a run depends on, beside its data: a frozen dataclass, of which the training reads one part."""

    @property
    def train(self) -> TrainConfig:
        """How the model is trained."""
        ...


class Trainable(nn.Module, ABC):
    """A model that says its own losses; nothing else about it matters to the training."""

    sees: ClassVar[type[Observation]] = Observation
    """What a training step is given: only a model that says `LabelledObservation` ever gets a label."""

    @property
    def background_slot(self) -> int | None:
        """The label that is meant as background; None if none is."""
        return 0

    @abstractmethod
    def losses(
        self, observation: Observation, *, step: int, fraction: float, generator: torch.Generator | None
    ) -> dict[str, Tensor]:
        """Loss terms by name: `total`, their weighted sum, which is minimised, and the unweighted terms, for logs.

        So many steps were made before this one, and that share of the budget, 0 to 1, is used up.
        """

    @abstractmethod
    def segment(self, observation: Observation) -> Segmentation:
        """Labels of every pixel of whole clips, without any randomness."""
