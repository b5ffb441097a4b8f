"""The fields of all components at given points: the background's everywhere, an object's only within its box."""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import torch
import torch.nn.functional as F
from einops import rearrange
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.geometry import to_box
from obpose.model.nerf.compose import OUTSIDE
from obpose.model.nerf.detail import Detail
from obpose.model.nerf.field import Field
from obpose.types import Boxes, Decoded

Colours = Literal["with", "without"]
Background = Literal["everywhere", "in boxes"]


@dataclass(frozen=True, eq=False)
class InBox:
    """A flat list of the points that lie in boxes; one in two boxes is there twice."""

    points: Float[Tensor, "n 3"]
    """In box coordinates, -1..1."""
    index: Int[Tensor, " n"]
    """Place among batch x frame x slot x ray."""
    owner: Int[Tensor, " n"]
    """Place among batch x frame x slot."""
    ray: Int[Tensor, " n"]
    """Place among batch x frame x ray."""


def decode(
    object_field: Field,
    background_field: Field | None,
    boxes: Boxes,
    active: Bool[Tensor, "batch slot"],
    z_what: Float[Tensor, "batch frame slot latent"],
    z_background: Float[Tensor, "batch frame background"] | None,
    points: Float[Tensor, "batch frame ray 3"],
    directions: Float[Tensor, "batch frame ray 3"],
    *,
    workspace_center: Float[Tensor, "3"],
    workspace_size: float,
    colours: Colours,
    floor: float | None = None,
    where_background: Background = "everywhere",
    detail: Detail | None = None,
) -> Decoded:
    """Density logits and colours of the components at world points seen along directions of any length.

    Where only the order of the components counts, the background's field need not be evaluated outside the boxes: with
    `in boxes` it has the logit 0 and black colours there. `detail`, with an owner for each of batch x frame x slot,
    corrects the objects' field.

    Addition: below the world's z = `floor`, where there is one, there are no objects. What lies on the table is the
    background's then, also in an object's shadow, which the object's field would explain better.

    Deviation from the authors' code: the background's points are not raw metres but -1..1 within the cube of edge
    `workspace_size`, which holds the cameras as well, so that its encoding has the same meaning for every dataset.
    """
    directions = F.normalize(directions, dim=-1)
    inside = points_in_boxes(points, boxes, active, floor=floor)
    of_background = decode_background(
        background_field,
        z_background,
        points,
        directions,
        workspace_center=workspace_center,
        workspace_size=workspace_size,
        colours=colours,
        only=None if where_background == "everywhere" else inside.ray.unique(),
    )
    of_slots = object_field.condition(rearrange(z_what, "b f s d -> (b f s) d")).corrected(detail)
    codes = of_slots.at(inside.owner)
    logits, hidden = object_field.density(inside.points, codes)
    shape = (*z_what.shape[:3], points.shape[2])
    all_logits = torch.cat([of_background.logits, spread(logits, inside.index, shape, OUTSIDE)], dim=2)
    if of_background.colours is None:
        return Decoded(logits=all_logits, colours=None)
    of_objects = object_field.colour(hidden, in_box_directions(directions, boxes, inside), codes)
    all_colours = torch.cat([of_background.colours, spread(of_objects, inside.index, shape, 0.0)], dim=2)
    return Decoded(logits=all_logits, colours=all_colours)


def decode_background(
    field: Field | None,
    z_background: Float[Tensor, "batch frame background"] | None,
    points: Float[Tensor, "batch frame ray 3"],
    directions: Float[Tensor, "batch frame ray 3"],
    *,
    workspace_center: Float[Tensor, "3"],
    workspace_size: float,
    colours: Colours,
    only: Int[Tensor, " n"] | None = None,
) -> Decoded:
    """The same for the background alone, as the only component; without one it is nowhere.

    With `only`, places among batch x frame x ray, it is evaluated at these points, and 0 at the others.
    """
    shape = (*points.shape[:2], 1, points.shape[2])
    if field is None or z_background is None:
        nowhere = points.new_full(shape, OUTSIDE)
        return Decoded(logits=nowhere, colours=None if colours == "without" else points.new_zeros(*shape, 3))
    at, along = (points - workspace_center) * (2 / workspace_size), F.normalize(directions, dim=-1)
    codes = field.condition(z_background)
    if only is None:
        codes = codes.of_all_points()
    else:
        at, along = at.flatten(0, 2)[only], along.flatten(0, 2)[only]
        codes = codes.flatten().at(only // points.shape[2])
    logits, hidden = field.density(at, codes)
    of_background = None if colours == "without" else field.colour(hidden, along, codes)
    if only is None:
        return Decoded(logits[:, :, None], None if of_background is None else of_background[:, :, None])
    everywhere = partial(spread, index=only, shape=shape, elsewhere=0.0)
    return Decoded(everywhere(logits), None if of_background is None else everywhere(of_background))


def points_in_boxes(
    points: Float[Tensor, "batch frame ray 3"],
    boxes: Boxes,
    active: Bool[Tensor, "batch slot"],
    *,
    floor: float | None = None,
) -> InBox:
    """Points above the floor that lie in boxes of active slots, box by box."""
    in_box = to_box(points[:, :, None], boxes.center, boxes.rotation, boxes.size)
    inside = (in_box.abs() <= 1).all(dim=-1) & active[:, None, :, None]
    if floor is not None:
        inside &= (points[..., 2] > floor)[:, :, None]
    index = inside.flatten().nonzero()[:, 0]
    _, _, slots, rays = inside.shape
    owner = index // rays
    return InBox(in_box.flatten(0, 3)[index], index, owner, owner // slots * rays + index % rays)


def in_box_directions(
    directions: Float[Tensor, "batch frame ray 3"], boxes: Boxes, inside: InBox
) -> Float[Tensor, "n 3"]:
    """View directions of the points in the boxes, turned with the boxes: R^-1 d."""
    rotation = rearrange(boxes.rotation, "b f s i j -> (b f s) i j")[inside.owner]
    return torch.einsum("ni,nij->nj", directions.flatten(0, 2)[inside.ray], rotation)


def spread(
    values: Float[Tensor, "n *value"], index: Int[Tensor, " n"], shape: tuple[int, ...], elsewhere: float
) -> Float[Tensor, "batch frame slot ray *value"]:
    """Values of a flat list put where they belong, and `elsewhere` at all other places."""
    size = torch.Size(shape).numel()
    full = values.new_full((size, *values.shape[1:]), elsewhere)
    return full.index_copy(0, index, values).unflatten(0, shape)
