"""Fields of all components at given points (paper, section Decoder)."""

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
from obpose.types import Active, Boxes, Decoded, RayPoints

Colours = Literal["with", "without"]
Background = Literal["everywhere", "in boxes"]
"""Points at which the background's field is evaluated. With `in boxes`, it has the logit 0 and black colours at points
outside of all boxes, which suffices if only the order of the components counts."""


@dataclass(frozen=True, eq=False)
class Fields:
    """Fields of a model, and their place in the world."""

    objects: Field
    """Field that all objects share."""
    background: Field | None
    center: Float[Tensor, "3"]
    """Centre of the cube in which the background's coordinates are -1..1, world frame, metres."""
    size: float
    """Edge of this cube, metres. It holds the cameras as well, so that encodings mean the same for every dataset.
    Deviation: the authors use metres."""
    floor: float | None
    """Height in metres below which there are no objects; None for no limit. An addition: things on the table belong to
    the background, also in an object's shadow, which the object's field would explain better."""

    def in_cube(self, points: Float[Tensor, "*shape 3"]) -> Float[Tensor, "*shape 3"]:
        """Convert world points to coordinates of -1..1 in the cube."""
        return (points - self.center) * (2 / self.size)

    def above_floor(self, points: Float[Tensor, "*shape 3"]) -> Bool[Tensor, "*shape"]:
        """Whether points are above the floor."""
        if self.floor is None:
            return torch.ones_like(points[..., 2], dtype=torch.bool)
        return points[..., 2] > self.floor


@dataclass(frozen=True, eq=False)
class Codes:
    """Latents of a scene, and boxes of its objects."""

    active: Active
    what: Float[Tensor, "batch frame slot latent"]
    background: Float[Tensor, "batch frame background"] | None
    boxes: Boxes | None
    """Boxes in which objects are; None if their fields fill the world, in the coordinates of the background."""
    detail: Detail | None = None
    """Corrections of the objects' field, with an owner for each of batch x frame x slot."""


@dataclass(frozen=True, eq=False)
class InBox:
    """Flat list of points in boxes; a point in two boxes occurs twice."""

    points: Float[Tensor, "n 3"]
    """Box coordinates, -1..1."""
    index: Int[Tensor, " n"]
    """Index in batch x frame x slot x ray."""
    owner: Int[Tensor, " n"]
    """Index in batch x frame x slot."""
    ray: Int[Tensor, " n"]
    """Index in batch x frame x ray."""


def decode(
    fields: Fields,
    codes: Codes,
    points: RayPoints,
    directions: RayPoints,
    *,
    colours: Colours,
    where_background: Background = "everywhere",
) -> Decoded:
    """Density logits and colours of all components at world points seen along directions of any length."""
    directions = F.normalize(directions, dim=-1)
    if codes.boxes is None:
        # World-frame fields: everywhere, like the background's.
        background = decode_background(fields, codes.background, points, directions, colours=colours)
        objects = _in_world(fields, codes, points, directions, colours)
    else:
        # Object-frame fields: only at points in boxes.
        inside = points_in_boxes(points, codes.boxes, codes.active, floor=fields.floor)
        only = None if where_background == "everywhere" else inside.ray.unique()
        background = decode_background(fields, codes.background, points, directions, colours=colours, only=only)
        objects = _in_boxes(fields, codes, codes.boxes, inside, points.shape[2], directions, colours)
    # The background is the first component.
    logits = torch.cat([background.logits, objects.logits], dim=2)
    if background.colours is None or objects.colours is None:
        return Decoded(logits=logits, colours=None)
    return Decoded(logits=logits, colours=torch.cat([background.colours, objects.colours], dim=2))


def _in_world(fields: Fields, codes: Codes, points: Tensor, directions: Tensor, colours: Colours) -> Decoded:
    """Objects whose fields fill the world."""
    conditioning = fields.objects.condition(codes.what).of_all_points()
    logits, hidden = fields.objects.density(fields.in_cube(points)[:, :, None], conditioning)
    # Inactive slots have no density, and no object has any below the floor.
    there = codes.active[:, None, :, None] & fields.above_floor(points)[:, :, None]
    logits = logits.masked_fill(~there, OUTSIDE)
    if colours == "without":
        return Decoded(logits=logits, colours=None)
    return Decoded(logits, fields.objects.colour(hidden, directions[:, :, None], conditioning))


def _in_boxes(
    fields: Fields, codes: Codes, boxes: Boxes, inside: InBox, rays: int, directions: Tensor, colours: Colours
) -> Decoded:
    """Objects in boxes, which are evaluated at the points inside only."""
    # One code per slot, selected for each point inside.
    of_slots = fields.objects.condition(rearrange(codes.what, "b f s d -> (b f s) d")).corrected(codes.detail)
    conditioning = of_slots.at(inside.owner)
    logits, hidden = fields.objects.density(inside.points, conditioning)
    shape = (*codes.what.shape[:3], rays)
    # Outside of its box an object has no density.
    all_logits = scatter(logits, inside.index, shape, OUTSIDE)
    if colours == "without":
        return Decoded(logits=all_logits, colours=None)
    found = fields.objects.colour(hidden, in_box_directions(directions, boxes, inside), conditioning)
    return Decoded(all_logits, scatter(found, inside.index, shape, 0.0))


def decode_background(
    fields: Fields,
    z_background: Float[Tensor, "batch frame background"] | None,
    points: RayPoints,
    directions: RayPoints,
    *,
    colours: Colours,
    only: Int[Tensor, " n"] | None = None,
) -> Decoded:
    """Density logits and colours of the background alone; a model without one has nothing there.

    With `only`, indices in batch x frame x ray, it is evaluated at these points, and 0 at the others.
    """
    shape = (*points.shape[:2], 1, points.shape[2])
    if fields.background is None or z_background is None:
        nowhere = points.new_full(shape, OUTSIDE)
        return Decoded(logits=nowhere, colours=None if colours == "without" else points.new_zeros(*shape, 3))
    # Points in the cube, and codes of their frames.
    at, along = fields.in_cube(points), F.normalize(directions, dim=-1)
    codes = fields.background.condition(z_background)
    if only is None:
        codes = codes.of_all_points()
    else:
        at, along = at.flatten(0, 2)[only], along.flatten(0, 2)[only]
        codes = codes.flatten().at(only // points.shape[2])
    # Density and colour there.
    logits, hidden = fields.background.density(at, codes)
    found = None if colours == "without" else fields.background.colour(hidden, along, codes)
    if only is None:
        return Decoded(logits[:, :, None], None if found is None else found[:, :, None])
    everywhere = partial(scatter, index=only, shape=shape, elsewhere=0.0)
    return Decoded(everywhere(logits), None if found is None else everywhere(found))


def points_in_boxes(points: RayPoints, boxes: Boxes, active: Active, *, floor: float | None = None) -> InBox:
    """Find the points above the floor that lie in boxes of active slots, box by box."""
    # Object-frame coordinates (paper, eq. 6).
    in_box = to_box(points[:, :, None], boxes.center, boxes.rotation, boxes.size)
    inside = (in_box.abs() <= 1).all(dim=-1) & active[:, None, :, None]
    if floor is not None:
        inside &= (points[..., 2] > floor)[:, :, None]
    # Flat list of the points inside.
    index = inside.flatten().nonzero()[:, 0]
    _, _, slots, rays = inside.shape
    owner = index // rays
    return InBox(in_box.flatten(0, 3)[index], index, owner, owner // slots * rays + index % rays)


def in_box_directions(directions: RayPoints, boxes: Boxes, inside: InBox) -> Float[Tensor, "n 3"]:
    """View directions of points in boxes, in the frames of the boxes: R^-1 d."""
    rotation = rearrange(boxes.rotation, "b f s i j -> (b f s) i j")[inside.owner]
    return torch.einsum("ni,nij->nj", directions.flatten(0, 2)[inside.ray], rotation)


def scatter(
    values: Float[Tensor, "n *value"], index: Int[Tensor, " n"], shape: tuple[int, ...], elsewhere: float
) -> Float[Tensor, "batch frame slot ray *value"]:
    """Put the values of a flat list at their indices, and `elsewhere` at all others."""
    size = torch.Size(shape).numel()
    full = values.new_full((size, *values.shape[1:]), elsewhere)
    return full.index_copy(0, index, values).unflatten(0, shape)
