"""Sampling of new scenes: latents from a prior, or objects found in clips, placed on a table without overlap."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from datagen.console.text import counted
from obpose.errors import UsageError
from obpose.model.nerf.detail import no_detail
from obpose.model.nerf.voxels import THRESHOLD, occupancy
from obpose.model.obpose import ObPose
from obpose.scenes.appearance.light import Light
from obpose.scenes.appearance.table_texture import Pattern
from obpose.scenes.extent import LEAST_VOXELS, above_table, occupied, shape_extent
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.flow import sample_grids
from obpose.scenes.priors.flow_prior import FlowPrior
from obpose.scenes.priors.gaussian import ScenePrior
from obpose.scenes.priors.grids import Grids, facing, together
from obpose.scenes.priors.object_bank import FoundObjects
from obpose.scenes.rendering import conditioning
from obpose.scenes.scene import Camera, Scene, upright

Source = ScenePrior | FlowPrior | FoundObjects
"""Source of sampled objects and backgrounds."""
_Thing = TypeVar("_Thing")
_TRIES, _LAYOUTS = 200, 10
"""Attempts to draw one object or a free place for it, and attempts to place all objects with new draws."""
_SKIN = 1e-6
"""Margin in metres that keeps objects above the table despite rounding."""


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Drawn objects that have no position yet."""

    what: Float[Tensor, "object what"]
    rotation: Float[Tensor, "object 3 3"]
    height: Float[Tensor, "object"] | None
    """Heights of the box centres, metres; None to put the lowest voxel on the table."""
    detail: Float[Tensor, "object edge edge edge 4"]
    alone: Float[Tensor, "object"]
    """Size of a grid that replaces the field, in box edges, 0 for none; see `Scene.alone`."""
    faces: bool
    """Whether the rotated x axis points to the camera; otherwise objects get a random heading."""


@dataclass(frozen=True, eq=False)
class _Placed:
    """Poses of the objects: box centres in metres and rotations, world from object."""

    center: Float[Tensor, "object 3"]
    rotation: Float[Tensor, "object 3 3"]


@torch.no_grad()
def sample_scene(
    origin: Origin,
    source: Source,
    *,
    objects: int,
    cameras: tuple[Camera, ...],
    generator: torch.Generator,
) -> Scene:
    """Sample a scene of one frame with a number of objects.

    Objects get a random heading, except those of a flow, whose observed side faces the first camera. The lowest voxel
    of a sampled object is on the table; found objects keep their height and are drawn with replacement.

    The paper leaves the poses of sampled objects to the user. Here positions are drawn such that the circles around
    the objects do not overlap, seen from above.

    Raises:
        UsageError: there is no room for this many objects.
    """
    camera = cameras[0].world_from_camera[:3, 3]
    for _ in range(_LAYOUTS):
        drawn = _draw(origin.model, source, objects, generator)
        placed = _place(origin.model, source, drawn, camera, generator)
        if placed is not None:
            break
    else:
        raise UsageError(f"There is no room for {counted(objects, 'object')} beside each other; sample fewer.")
    background, light, pattern = _surroundings(source, generator)
    return Scene(
        ids=tuple(range(1, objects + 1)),
        what=drawn.what[None],
        center=placed.center[None],
        rotation=placed.rotation[None],
        detail=drawn.detail,
        alone=drawn.alone,
        background=background,
        light=light,
        pattern=pattern,
        cameras=cameras,
        model=origin.hash,
        checkpoint=origin.name,
    )


def _place(
    model: ObPose, source: Source, drawn: _Drawn, camera: Float[Tensor, "3"], generator: torch.Generator
) -> _Placed | None:
    """Place objects on the table without overlap; None if there is no room for one of them."""
    objects = len(drawn.what)
    center, rotation = torch.zeros(objects, 3), torch.zeros(objects, 3, 3)
    reaches: list[float] = []
    for place in range(objects):
        turn = upright(float(torch.rand((), generator=generator)) * 2 * math.pi, center) @ drawn.rotation[place]
        codes = conditioning(model, drawn.what[place], drawn.detail[place], drawn.alone[place])
        extent = shape_extent(model, codes, turn)
        height = float(-extent[:, 2].min() if drawn.height is None else drawn.height[place])
        extent = above_table(extent, height + _SKIN)
        reach = float(extent[:, :2].norm(dim=-1).max())
        middle = _free_place(source, center[:place, :2], reaches, reach, generator)
        if middle is None:
            return None
        center[place, :2] = middle
        center[place, 2] = height
        rotation[place] = facing(center[place], camera) @ drawn.rotation[place] if drawn.faces else turn
        reaches.append(reach)
    return _Placed(center, rotation)


def _draw(model: ObPose, source: Source, objects: int, generator: torch.Generator) -> _Drawn:
    if isinstance(source, FoundObjects):
        chosen = torch.randint(len(source.what), (objects,), generator=generator)
        found = (source.what[chosen], source.rotation[chosen], source.height[chosen], source.detail[chosen])
        return _Drawn(*found, torch.zeros(objects), faces=False)
    level = torch.eye(3).expand(objects, 3, 3)
    if isinstance(source, FlowPrior):
        what = source.flow.code.expand(objects, -1)
        grids = _draw_grids(model, source, objects, generator)
        # Boxes share the centres and axes of the grids; parts of a grid outside of its box are cut off.
        alone = 2 * grids.half / model.config.model.pose.box_size
        return _Drawn(what, level, None, grids.values, alone, faces=True)
    what = _draw_codes(model, source, objects, generator)
    return _Drawn(what, level, None, no_detail(objects, what), torch.zeros(objects), faces=False)


def _surroundings(source: Source, generator: torch.Generator) -> tuple[Float[Tensor, "1 background"], Light, Pattern]:
    """Draw background, light and table pattern."""
    if isinstance(source, FoundObjects):
        place = int(torch.randint(len(source.background), (), generator=generator))
        return source.background[place, None], *source.tables.like(place, generator)
    return source.background.draw(1, generator), *source.tables.draw(generator)


@torch.no_grad()
def _draw_codes(
    model: ObPose, prior: ScenePrior, objects: int, generator: torch.Generator
) -> Float[Tensor, "object latent"]:
    """Draw codes of objects that have enough voxels; after too many attempts, any codes.

    In models with sharp surfaces, some codes of a Gaussian give hardly any density. They are drawn again, as are
    objects only in the upper half of their box, whose box centre would be below the table.
    """

    def voxels(code: Float[Tensor, "latent"]) -> int:
        found = occupied(model, model.object_field.condition(code))
        return len(found) if len(found) and bool(found[:, 2].min() <= 0) else 0

    codes = _drawn_again(lambda count: list(prior.what.draw(count, generator)), voxels, objects)
    return torch.stack(codes) if codes else prior.what.draw(0, generator)


def _draw_grids(model: ObPose, prior: FlowPrior, objects: int, generator: torch.Generator) -> Grids:
    """Draw grids of objects that have enough voxels; after too many attempts, any grids."""
    threshold = THRESHOLD
    grids = _drawn_again(
        lambda count: sample_grids(prior.flow, count, generator).apart(),
        lambda grid: int((occupancy(grid.values[..., 0]) > threshold).sum()),
        objects,
    )
    return together(grids, like=prior.flow.code)


def _drawn_again(draw: Callable[[int], list[_Thing]], voxels: Callable[[_Thing], int], objects: int) -> list[_Thing]:
    """Draw objects; those with too few voxels are drawn again, up to `_TRIES` times."""
    drawn = draw(objects)
    for _ in range(_TRIES):
        nowhere = [place for place, each in enumerate(drawn) if voxels(each) < LEAST_VOXELS]
        if not nowhere:
            break
        for place, each in zip(nowhere, draw(len(nowhere)), strict=True):
            drawn[place] = each
    return drawn


def _free_place(
    source: Source,
    taken: Float[Tensor, "object 2"],
    reaches: list[float],
    reach: float,
    generator: torch.Generator,
) -> Float[Tensor, "2"] | None:
    for _ in range(_TRIES):
        place = source.low + (source.high - source.low) * torch.rand(2, generator=generator)
        away = (taken - place).norm(dim=-1)
        if bool((away > reach + torch.tensor(reaches)).all()):
            return place
    return None
