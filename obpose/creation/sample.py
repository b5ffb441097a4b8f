"""Scenes that were never seen: latents from a prior, objects on the table beside each other."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.creation.origin import Origin
from obpose.creation.prior import ScenePrior
from obpose.creation.scene import Camera, Scene, upright
from obpose.errors import UsageError
from obpose.geometry import from_box
from obpose.model import ObPose
from obpose.nerf.detail import no_detail
from obpose.nerf.voxels import lattice_points, occupancy

_TRIES = 200
_CELLS = 16
_LEAST_VOXELS = 8
"""Objects of fewer of these voxels are drawn again: in boxes of 20 cm it is a cube of 25 mm. Where surfaces are sharp a
Gaussian over codes has some that are hardly anywhere dense."""


@torch.no_grad()
def sample_scene(
    origin: Origin,
    prior: ScenePrior,
    *,
    objects: int,
    cameras: tuple[Camera, ...],
    generator: torch.Generator,
) -> Scene:
    """A scene of one frame with so many objects, turned about the vertical at random, their lowest voxel on the table.

    The paper leaves the poses of sampled objects to the user; these are drawn such that no two objects' voxels, seen
    from above, come nearer to each other than both reach from their middles.

    Raises:
        UsageError: there is no room for so many.
    """
    what = _draw(origin.model, prior, objects, generator)
    center, rotation = torch.zeros(objects, 3), torch.zeros(objects, 3, 3)
    reaches: list[float] = []
    for place in range(objects):
        turn = upright(float(torch.rand((), generator=generator)) * 2 * math.pi, what)
        extent = shape_extent(origin.model, what[place], turn)
        reach = float(extent[:, :2].norm(dim=-1).max())
        middle = _free_place(prior, center[:place, :2], reaches, reach, generator)
        center[place, :2] = middle
        center[place, 2] = -extent[:, 2].min()
        rotation[place] = turn
        reaches.append(reach)
    return Scene(
        ids=tuple(range(1, objects + 1)),
        what=what[None],
        center=center[None],
        rotation=rotation[None],
        detail=no_detail(objects, what),
        background=prior.background.draw(1, generator),
        cameras=cameras,
        model=origin.hash,
        checkpoint=origin.name,
    )


def _draw(model: ObPose, prior: ScenePrior, objects: int, generator: torch.Generator) -> Float[Tensor, "object latent"]:
    """Codes of objects that are somewhere; of a model that has none, any."""
    what = prior.what.draw(objects, generator)
    for _ in range(_TRIES):
        nowhere = [len(_occupied(model, code)) < _LEAST_VOXELS for code in what]
        if not any(nowhere):
            break
        what[nowhere] = prior.what.draw(sum(nowhere), generator)
    return what


@torch.no_grad()
def shape_extent(
    model: ObPose, what: Float[Tensor, "latent"], rotation: Float[Tensor, "3 3"]
) -> Float[Tensor, "corner 3"]:
    """Occupied voxels of an object relative to the middle of its box, world axes, metres; the middle if none is."""
    voxels = _occupied(model, what)
    if not len(voxels):
        voxels = voxels.new_zeros(1, 3)
    return from_box(voxels, torch.zeros(3), rotation, model.config.model.pose.box_size)


def _occupied(model: ObPose, what: Float[Tensor, "latent"]) -> Float[Tensor, "voxel 3"]:
    """Middles of the voxels that an object is in, in its box."""
    lattice = lattice_points(_CELLS, None, what)
    logits, _ = model.object_field.density(lattice, model.object_field.condition(what))
    return lattice[occupancy(logits) > model.config.model.voxel_threshold]


def _free_place(
    prior: ScenePrior,
    taken: Float[Tensor, "object 2"],
    reaches: list[float],
    reach: float,
    generator: torch.Generator,
) -> Float[Tensor, "2"]:
    for _ in range(_TRIES):
        place = prior.low + (prior.high - prior.low) * torch.rand(2, generator=generator)
        away = (taken - place).norm(dim=-1)
        if bool((away > reach + torch.tensor(reaches)).all()):
            return place
    raise UsageError(
        f"There is no room for object {len(reaches) + 1} beside the others; sample fewer, or with another --seed."
    )
