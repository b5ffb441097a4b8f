"""Which scenes are worth a look: the worst of a model, and those on which two models disagree most."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from benchmark.metrics.errors_by_type import ERROR_TYPES
from benchmark.report.observations import Objects

Image = tuple[int, int, int]
"""Scene, frame and view."""


@dataclass(frozen=True)
class Card:
    """One image of the gallery, and the models whose label maps stand beside it."""

    image: Image
    models: tuple[int, ...]


def worst_scenes(scores: Float64[np.ndarray, "scene"], count: int) -> list[int]:
    """The scenes of lowest score, worst first; scenes without a score are left out."""
    return [int(i) for i in np.argsort(scores, kind="stable")[:count] if np.isfinite(scores[i])]


def disagreements(a: Float64[np.ndarray, "scene"], b: Float64[np.ndarray, "scene"], count: int) -> list[int]:
    """The scenes on which two models' scores differ most, in either direction; equal scores do not count."""
    gaps = np.nan_to_num(np.abs(a - b), nan=0.0)
    return [int(i) for i in np.argsort(-gaps, kind="stable")[:count] if gaps[i] > 0]


def typical_scenes(scores: Sequence[Float64[np.ndarray, "scene"]], count: int) -> list[int]:
    """The scene of middling difficulty by all models' mean, then the hardest ones."""
    stacked = np.stack(scores)
    defined = np.isfinite(stacked).sum(axis=0)
    means = np.where(defined > 0, np.nansum(stacked, axis=0) / np.maximum(defined, 1), np.nan)
    order = worst_scenes(means, len(means))
    return list(dict.fromkeys([order[len(order) // 2], *order]))[:count] if order else []


def telling_image(objects: Objects, scene: int, values: Float64[np.ndarray, "observation"]) -> Image:
    """The image of a scene whose objects have the largest mean value."""
    inside = np.flatnonzero(objects.scene == scene)
    places, members = np.unique(np.column_stack([objects.frame, objects.view])[inside], axis=0, return_inverse=True)
    members = members.ravel()
    means = np.bincount(members, values[inside]) / np.bincount(members)
    frame, view = places[int(np.argmax(np.round(means, 9)))]
    return scene, int(frame), int(view)


def errors_in_words(objects: Objects, image: Image, errors: Float64[np.ndarray, "observation type"]) -> str:
    """The errors of one run in one image, such as `2 merged, 1 missed`."""
    scene, frame, view = image
    inside = (objects.scene == scene) & (objects.frame == frame) & (objects.view == view)
    counts = errors[inside].sum(axis=0)
    return ", ".join(_words(ERROR_TYPES, counts)) or "no error"


def _words(names: Iterable[str], counts: np.ndarray) -> list[str]:
    return [f"{round(float(count))} {name}" for name, count in zip(names, counts, strict=True) if count >= 0.5]
