"""Distribution of tables: lights and textures that were found in clips."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.scenes.appearance.light import Light, no_light
from obpose.scenes.appearance.table_texture import PATCH, Texture, no_texture, patch_of, texture_like
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.scene import Scene
from obpose.types import Observation

MOST = 32
"""Largest number of tables; each takes 12 kB in a file."""


@dataclass(frozen=True, eq=False)
class Tables:
    """Lights and textures to draw from; may be empty."""

    lights: Float[Tensor, "table 4"]
    """Lights, as in `Appearance.light`."""
    patches: Float[Tensor, "table patch patch 3"]
    """Patches of textures; new textures resemble one of them (`obpose.scenes.appearance.table_texture`)."""

    def draw(self, generator: torch.Generator) -> tuple[Light, Texture]:
        """Draw the light of one table, and a texture like its own; neither if there are no tables."""
        if not len(self.lights):
            return no_light(self.lights), no_texture(self.lights)
        place = int(torch.randint(len(self.lights), (), generator=generator))
        return self.lights[place], texture_like(self.patches[place], generator)


def no_tables(like: Tensor) -> Tables:
    """Give an empty distribution, in the type of `like`."""
    return Tables(like.new_zeros(0, 4), like.new_zeros(0, PATCH, PATCH, 3))


def find_tables(origin: Origin, clips: Iterable[Observation], *, refinements: int) -> Tables:
    """Infer scenes from clips (each a batch of one), fit them in `refinements` steps, and collect their tables."""
    return tables_of(infer_scene(origin, clip, refinements=refinements) for clip in clips)


def tables_of(scenes: Iterable[Scene]) -> Tables:
    """Collect the tables of fitted scenes."""
    found = [(scene.appearance.light, patch_of(scene.appearance.texture)) for scene in scenes]
    if not found:
        return no_tables(torch.zeros(()))
    lights, patches = zip(*found, strict=True)
    return Tables(torch.stack(lights), torch.stack(patches))
