"""What `obpose.train` asks of a model, so that other architectures are trained by the same loop."""

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from obpose.types import Observation, Segmentation


class Trainable(nn.Module, ABC):
    """A model that says its own losses; nothing else about it matters to the training."""

    @abstractmethod
    def losses(self, observation: Observation, *, step: int, generator: torch.Generator | None) -> dict[str, Tensor]:
        """Loss terms by name: `total`, their weighted sum, which is minimised, and the unweighted terms, for logs."""

    @abstractmethod
    def segment(self, observation: Observation) -> Segmentation:
        """Labels of every pixel of whole clips, without any randomness."""
