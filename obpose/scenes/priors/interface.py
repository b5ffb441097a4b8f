"""Interface of priors: what a new scene is sampled from, and how priors are fitted beside a model's weights."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.errors import CorruptFile
from obpose.model.obpose import ObPose
from obpose.scenes.appearance import Appearance
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.mixture import Mixture
from obpose.scenes.priors.tables import Tables
from obpose.scenes.refine import STEPS
from obpose.storage.tensors import Expect, State, read_tensors

WEIGHTS = "weights"
"""Metadata key of a prior's file: SHA-256 of the model's weights that it belongs to."""
_MOST_BYTES = 2**28

Say = Callable[[str], None]
"""Callback for progress messages."""


@dataclass(frozen=True, eq=False)
class Objects:
    """Sampled objects that have no position yet."""

    what: Float[Tensor, "object what"]
    appearance: Appearance
    """Details of the objects; light and table texture are not set."""
    face_camera: bool
    """Whether the x axis of each object points to the camera; otherwise objects get a random heading."""


@runtime_checkable
class ObjectPrior(Protocol):
    """Distribution of objects."""

    def draw(self, model: ObPose, count: int, generator: torch.Generator) -> Objects:
        """Draw objects that have enough voxels; after too many attempts, any objects."""
        ...


@dataclass(frozen=True, eq=False)
class ScenePrior:
    """Distribution of objects, backgrounds and tables; positions are drawn between `low` and `high`."""

    objects: ObjectPrior
    background: Mixture
    tables: Tables
    low: Float[Tensor, "2"]
    """Lowest world x and y of the objects' box centres, metres."""
    high: Float[Tensor, "2"]
    """Highest world x and y of the objects' box centres, metres."""


@dataclass(frozen=True)
class FitSettings:
    """Settings of fitting a prior."""

    clips: int
    """Number of clips, from the first of the training split on."""
    steps: int
    """Training steps of a flow."""
    seed: int
    workers: int
    """Number of processes that look for objects."""
    refinements: int = STEPS
    """Steps in which each clip is fitted to its frames."""
    least_objects: int = 32
    """Fewest objects that a flow is trained on."""
    batch: int = 256
    """Objects per training step of a flow."""
    save_steps: int = 250
    """Interval at which the training of a flow is saved and reported."""
    compared: int = 200
    """Number of samples, and of held-out objects, that are compared with the training objects."""


@dataclass(frozen=True)
class PriorKind:
    """A family of priors."""

    load: Callable[[Origin], ScenePrior]
    """Load the prior of a model."""
    file: str | None = None
    """Name of its file, in the folder of the model's weights; None if the weights suffice."""
    fit: Callable[[Origin, Path, FitSettings, Say], Path] | None = None
    """Fit the prior to the training clips of a dataset; give the path of the file. None if there is nothing to fit."""
    clips: int = 0
    """Default number of clips to fit it to."""


def read_prior(origin: Origin, file: str, advice: str, expect: Expect) -> State:
    """Read the tensors of a prior's file.

    Raises:
        CorruptFile: the file is damaged, or belongs to other weights.
    """
    path = origin.folder / file
    tensors, metadata = read_tensors(path, advice, expect, most_bytes=_MOST_BYTES)
    if metadata.get(WEIGHTS) != origin.hash:
        raise CorruptFile(f"{path} was fitted to other weights than those beside it; {advice}")
    return tensors
