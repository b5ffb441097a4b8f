"""Which models there are: a name, how to build it, and the version that its results carry."""

import difflib
from collections.abc import Callable
from dataclasses import dataclass

from benchmark.baselines.plane_dbscan import PlaneDbscan
from benchmark.interface import Segmenter
from datagen.errors import UsageError


@dataclass(frozen=True)
class ModelSpec:
    """One model that can be named on the command line."""

    build: Callable[[], Segmenter]
    version: int
    """Rises when the model's results change."""
    description: str


MODELS: dict[str, ModelSpec] = {
    "plane-dbscan": ModelSpec(PlaneDbscan, 1, "RANSAC plane removal, then DBSCAN on the points; needs no training"),
}


def find_model(name: str) -> ModelSpec:
    """The model of that name.

    Raises:
        UsageError: there is none; suggests the nearest name.
    """
    if name not in MODELS:
        near = difflib.get_close_matches(name, MODELS, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise UsageError(f"Unknown model {name!r}; {hint}There are: {', '.join(sorted(MODELS))}.")
    return MODELS[name]
