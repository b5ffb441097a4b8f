"""The fields of all components at given points where objects have no boxes: each field fills the whole world."""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from obpose.model.nerf.components import Colours, decode_background
from obpose.model.nerf.compose import OUTSIDE
from obpose.model.nerf.field import Field
from obpose.types import Decoded


def decode_world(
    object_field: Field,
    background_field: Field | None,
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
) -> Decoded:
    """Density logits and colours of the components at world points seen along directions of any length.

    All fields are in the background's coordinates, -1..1 in the cube of edge `workspace_size`. Without a background its
    component is nowhere. Below the world's z = `floor`, where there is one, there are no objects.
    """
    directions = F.normalize(directions, dim=-1)
    frame = {"workspace_center": workspace_center, "workspace_size": workspace_size, "colours": colours}
    background = decode_background(background_field, z_background, points, directions, **frame)
    in_world = ((points - workspace_center) * (2 / workspace_size))[:, :, None]
    codes = object_field.condition(z_what).of_all_points()
    logits, hidden = object_field.density(in_world, codes)
    there = active[:, None, :, None].expand(logits.shape)
    if floor is not None:
        there = there & (points[..., 2] > floor)[:, :, None]
    all_logits = torch.cat([background.logits, logits.masked_fill(~there, OUTSIDE)], dim=2)
    if background.colours is None:
        return Decoded(logits=all_logits, colours=None)
    of_objects = object_field.colour(hidden, directions[:, :, None], codes)
    return Decoded(logits=all_logits, colours=torch.cat([background.colours, of_objects], dim=2))
