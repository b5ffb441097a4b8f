"""Objects as a model found them in clips, to be put together anew: whole, with the details that codes leave out.

An addition, and no model of objects: each of them was seen, only its company and its place are new.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from datagen.wording import counted
from obpose.creation.extent import LEAST_VOXELS, above_table, shape_extent
from obpose.creation.infer import infer_scene
from obpose.creation.origin import Origin
from obpose.creation.prior import learned_prior, table_part
from obpose.creation.rendering import object_codes
from obpose.creation.scene import Scene
from obpose.creation.tables import Tables, tables_of
from obpose.errors import UsageError
from obpose.types import Observation

LEAST_PLACES = 20
"""Places of fewer objects do not say on which part of the table objects are; then it is the middle of the workspace."""


@dataclass(frozen=True, eq=False)
class FoundObjects:
    """Objects and backgrounds of the last frames of clips, in which most have come to rest, and where they were."""

    what: Float[Tensor, "object what"]
    rotation: Float[Tensor, "object 3 3"]
    """World from object, as it was found."""
    height: Float[Tensor, "object"]
    """Of the middle of its box above the table, metres: what a field has below the table no camera can have seen, and
    it is shown as little where an object keeps its height."""
    detail: Float[Tensor, "object edge edge edge 4"]
    background: Float[Tensor, "clip background"]
    tables: Tables
    """One for each clip."""
    low: Float[Tensor, "2"]
    """Of the objects' middles, world x and y, metres."""
    high: Float[Tensor, "2"]


def find_objects(origin: Origin, clips: Iterable[Observation], *, refinements: int) -> FoundObjects:
    """Those of scenes that are inferred from clips, a batch of one each, and fitted to them in so many steps.

    Objects that are hardly anywhere dense above the table are left out.

    Raises:
        UsageError: there is no object at all.
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
