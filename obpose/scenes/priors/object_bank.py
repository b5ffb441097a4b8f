"""Bank of objects that a model found in clips, with their residual details, for recombination in new scenes.

Not in the paper. Non-parametric: every object was observed, only its position and the other objects are new.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from datagen.console.text import counted
from obpose.errors import UsageError
from obpose.scenes.extent import LEAST_VOXELS, above_table, shape_extent
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.gaussian import learned_prior, table_part
from obpose.scenes.priors.tables import Tables, tables_of
from obpose.scenes.rendering import object_codes
from obpose.scenes.scene import Scene
from obpose.types import Observation

LEAST_PLACES = 20
"""Least number of objects to estimate the occupied part of the table; with fewer it is the middle of the workspace."""


@dataclass(frozen=True, eq=False)
class FoundObjects:
    """Objects, their poses and backgrounds from the last frames of clips, where most objects are at rest."""

    what: Float[Tensor, "object what"]
    rotation: Float[Tensor, "object 3 3"]
    """World from object, as observed."""
    height: Float[Tensor, "object"]
    """Height of the box centre above the table, metres. Objects keep it in new scenes, so that the part of a field
    below the table, which no camera saw, stays hidden."""
    detail: Float[Tensor, "object edge edge edge 4"]
    background: Float[Tensor, "clip background"]
    tables: Tables
    """Light and pattern of the table, one for each clip."""
    low: Float[Tensor, "2"]
    """Lowest world x and y of the objects' box centres, metres."""
    high: Float[Tensor, "2"]
    """Highest world x and y of the objects' box centres, metres."""


def find_objects(origin: Origin, clips: Iterable[Observation], *, refinements: int) -> FoundObjects:
    """Infer scenes from clips (each a batch of one), fit them in `refinements` steps, and collect their objects.

    Objects with hardly any dense voxels above the table are left out.

    Raises:
        UsageError: no object was found.
    """
    scenes = [infer_scene(origin, clip, refinements=refinements) for clip in clips]
    places = [(scene, place) for scene in scenes for place in range(len(scene.ids)) if _is_there(origin, scene, place)]
    if not places:
        raise UsageError(f"No objects were found in {counted(len(scenes), 'clip')}; give more, or others.")
    center = torch.stack([scene.center[-1, place] for scene, place in places])
    low, high = table_part(center[:, :2])
    if len(places) < LEAST_PLACES:
        prior = learned_prior(origin.model)
        low, high = prior.low, prior.high
    return FoundObjects(
        what=torch.stack([scene.what[-1, place] for scene, place in places]),
        rotation=torch.stack([scene.rotation[-1, place] for scene, place in places]),
        height=center[:, 2],
        detail=torch.stack([scene.detail[place] for scene, place in places]),
        background=torch.stack([scene.background[-1] for scene in scenes]),
        tables=tables_of(scenes),
        low=low,
        high=high,
    )


def _is_there(origin: Origin, scene: Scene, place: int) -> bool:
    codes = object_codes(origin.model, scene, -1, place)
    extent = shape_extent(origin.model, codes, scene.rotation[-1, place])
    return len(above_table(extent, float(scene.center[-1, place, 2]))) >= LEAST_VOXELS
