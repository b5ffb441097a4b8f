"""Sampling of new scenes: objects from a prior, placed on a table without overlap."""

import math
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

import datagen.scene
from datagen.config import Rig
from datagen.console.text import counted
from obpose.errors import UsageError
from obpose.model.obpose import ObPose
from obpose.scenes.bounds import shape_extent
from obpose.scenes.model_ref import Origin
from obpose.scenes.priors.grids import facing
from obpose.scenes.priors.interface import Objects, ScenePrior
from obpose.scenes.rendering import conditioning
from obpose.scenes.scene import Camera, Scene, upright

_TRIES, _LAYOUTS = 200, 10
"""Attempts to find a free place for an object, and attempts to place all objects with new draws."""

_VIEW_PIXELS = 128
"""Width and height of the default camera."""

Poses = tuple[Float[Tensor, "object 3"], Float[Tensor, "object 3 3"]]
"""Box centres in metres, and rotations, world from object."""


def default_camera() -> Camera:
    """Give the camera of the recipe `moving`: from the side of the x axis, looking down at the origin by 55 degrees."""
    rig, size = Rig(), _VIEW_PIXELS
    elevation = math.radians(rig.elevation)
    position = rig.distance * math.cos(elevation), 0.0, rig.distance * math.sin(elevation)
    camera = datagen.scene.Camera(position, rig.target, math.radians(rig.field_of_view))
    k, pose = (torch.from_numpy(values).float() for values in (camera.k(size, size), camera.world_from_camera))
    return Camera(k, pose, size, size)


@torch.no_grad()
def sample_scene(
    origin: Origin, prior: ScenePrior, *, objects: int, cameras: tuple[Camera, ...], generator: torch.Generator
) -> Scene:
    """Sample a scene of one frame with a number of objects.

    Objects get a random heading, except those of a flow, whose observed side faces the first camera. The lowest voxel
    of an object is on the table.

    The paper leaves the poses of sampled objects to the user. Here positions are drawn such that the circles around
    the objects do not overlap, seen from above.

    Raises:
        UsageError: there is no room for this many objects.
    """
    # Objects with room beside each other; drawn again if there is none.
    camera = cameras[0].world_from_camera[:3, 3]
    for _ in range(_LAYOUTS):
        drawn = prior.objects.draw(origin.model, objects, generator)
        poses = _place(origin.model, prior, drawn, camera, generator)
        if poses is not None:
            break
    else:
        raise UsageError(f"There is no room for {counted(objects, 'object')} beside each other; sample fewer.")
    background = prior.background.draw(1, generator)
    light, texture = prior.tables.draw(generator)
    center, rotation = poses
    return Scene(
        ids=tuple(range(1, objects + 1)),
        what=drawn.what[None],
        center=center[None],
        rotation=rotation[None],
        background=background,
        appearance=replace(drawn.appearance, light=light, texture=texture),
        cameras=cameras,
        model=origin.hash,
        checkpoint=origin.name,
    )


def _place(
    model: ObPose, prior: ScenePrior, drawn: Objects, camera: Float[Tensor, "3"], generator: torch.Generator
) -> Poses | None:
    """Place objects on the table without overlap; None if there is no room for one of them."""
    objects = len(drawn.what)
    center, rotation = torch.zeros(objects, 3), torch.zeros(objects, 3, 3)
    reaches: list[float] = []
    for place in range(objects):
        turn = upright(float(torch.rand((), generator=generator)) * 2 * math.pi, center)
        details = drawn.appearance.detail[place], drawn.appearance.own_scale[place]
        # Stand the decoded shape on the table, and measure how far it reaches.
        extent = shape_extent(model, conditioning(model, drawn.what[place], *details), turn)
        height = float(-extent[:, 2].min())
        reach = float(extent[:, :2].norm(dim=-1).max())
        # Find a place clear of those before.
        middle = _free_place(prior, center[:place, :2], reaches, reach, generator)
        if middle is None:
            return None
        center[place, :2], center[place, 2] = middle, height + model.config.model.table_top
        rotation[place] = facing(center[place], camera) if drawn.face_camera else turn
        reaches.append(reach)
    return center, rotation


def _free_place(
    prior: ScenePrior, taken: Float[Tensor, "object 2"], reaches: list[float], reach: float, generator: torch.Generator
) -> Float[Tensor, "2"] | None:
    """Draw a position whose circle overlaps no other; None after too many attempts."""
    for _ in range(_TRIES):
        place = prior.low + (prior.high - prior.low) * torch.rand(2, generator=generator)
        away = (taken - place).norm(dim=-1)
        if bool((away > reach + torch.tensor(reaches)).all()):
            return place
    return None
