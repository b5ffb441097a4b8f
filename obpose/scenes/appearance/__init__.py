"""Appearance of scenes beyond their latents: details and extents of objects, light and table texture.

Not in the paper, whose scenes have none of these.
"""

from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.model.nerf.detail import no_detail
from obpose.scenes.appearance.light import Light, no_light
from obpose.scenes.appearance.table_texture import Texture, no_texture


@dataclass(frozen=True, eq=False)
class Appearance:
    """Parts of a scene that its latents leave out; values are 0 where nothing was fitted."""

    detail: Float[Tensor, "object edge edge edge 4"]
    """Residual grids of density and colour (`obpose.model.nerf.detail`)."""
    own_scale: Float[Tensor, "object"]
    """If positive, the residual grid replaces the object's field, in a cube of this many times the box's edge."""
    half_extent: Float[Tensor, "object 3"]
    """Half edges of the smallest box around what the frames show of the object, metres, centred like the object's box
    and along its axes. Meshes are not larger. 0: unknown."""
    light: Light = field(default_factory=no_light)
    """Light that casts shadows on the background (`obpose.scenes.appearance.light`)."""
    texture: Texture = field(default_factory=no_texture)
    """Texture of the table (`obpose.scenes.appearance.table_texture`)."""

    def only(self, places: list[int]) -> "Appearance":
        """Keep the objects in these places."""
        kept = {name: getattr(self, name)[places] for name in _OF_OBJECTS}
        return replace(self, **kept)

    def with_object(self, other: "Appearance", place: int) -> "Appearance":
        """Append an object of another scene."""
        joined = {name: torch.cat([getattr(self, name), getattr(other, name)[place, None]]) for name in _OF_OBJECTS}
        return replace(self, **joined)


_OF_OBJECTS = ("detail", "own_scale", "half_extent")
"""Fields with one entry per object."""


def no_appearance(objects: int, like: Tensor) -> Appearance:
    """Give the appearance of a scene that is nothing but its latents, on the device and in the type of `like`."""
    detail, own_scale, half_extent = no_detail(objects, like), like.new_zeros(objects), like.new_zeros(objects, 3)
    return Appearance(detail, own_scale, half_extent, no_light(like), no_texture(like))
