"""Tables to sample scenes on: lights and patterns as they are found in clips."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.scenes.appearance.light import Light, is_light, no_light
from obpose.scenes.appearance.table_texture import SPOT, Pattern, no_pattern, pattern_like, spot_of
from obpose.scenes.infer import infer_scene
from obpose.scenes.model_ref import Origin
from obpose.scenes.scene import Scene
from obpose.types import Observation

MOST = 32
"""Tables that are kept, as each takes 25 kB."""


@dataclass(frozen=True, eq=False)
class Tables:
    """To be drawn from; there may be none."""

    lights: Float[Tensor, "table 4"]
    """As `Scene.light`."""
    spots: Float[Tensor, "table spot spot 3"]
    """Of patterns; one that is drawn is like one of them (`obpose.scenes.appearance.table_texture`)."""

    def draw(self, generator: torch.Generator) -> tuple[Light, Pattern]:
        """Of one of the tables; where there are none, no light and no pattern."""
        if not len(self.lights):
            return no_light(self.lights), no_pattern(self.lights)
        return self.like(int(torch.randint(len(self.lights), (), generator=generator)), generator)

    def like(self, place: int, generator: torch.Generator) -> tuple[Light, Pattern]:
        """The light of one of the tables, and a pattern like its own."""
        return self.lights[place], pattern_like(self.spots[place], generator)


def no_tables(like: Tensor) -> Tables:
    """None, of the same kind of numbers as `like`."""
    return Tables(like.new_zeros(0, 4), like.new_zeros(0, SPOT, SPOT, 3))


def find_tables(origin: Origin, clips: Iterable[Observation], *, refinements: int) -> Tables:
    """Those of scenes that are inferred from clips, a batch of one each, and fitted to them in so many steps."""
    return tables_of(infer_scene(origin, clip, refinements=refinements) for clip in clips)


def tables_of(scenes: Iterable[Scene]) -> Tables:
    """Those of fitted scenes."""
    found = [(scene.light, spot_of(scene.pattern)) for scene in scenes]
    if not found:
        return no_tables(torch.zeros(()))
    lights, spots = zip(*found, strict=True)
    return Tables(torch.stack(lights), torch.stack(spots))


def are_tables(lights: Tensor, spots: Tensor) -> bool:
    """Whether arrays are those of tables; files may come from anywhere."""
    count = len(spots) if spots.ndim else 0
    sizes = lights.shape == (count, 4) and spots.shape == (count, SPOT, SPOT, 3)
    return sizes and lights.dtype == torch.float32 and bool(spots.isfinite().all()) and all(map(is_light, lights))
