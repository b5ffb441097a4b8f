"""Observed surface points, each assigned to an inferred object."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Int, UInt8
from torch import Tensor

from obpose.geometry import unproject
from obpose.model.nerf.compose import OUTSIDE
from obpose.model.nerf.marching import Component, in_box
from obpose.pictures import TINT, colours_of, to_bytes
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene
from obpose.types import Observation


@dataclass(frozen=True, eq=False)
class Cloud:
    """Observed surface points of one object in its own frame, or of the background in the world, metres."""

    points: Float32[np.ndarray, "point 3"]
    colours: UInt8[np.ndarray, "point 3"]
    """Observed colours, sRGB."""


@torch.no_grad()
def observed_clouds(renderer: Renderer, scene: Scene, frame: int, clip: Observation) -> dict[int, Cloud]:
    """Unproject all views of one frame, and group the points by inferred object; 0 is the background.

    Object frames have their origin in the middle of the object's box.
    """
    valid = clip.valid[0, frame]
    points, colours = unproject(clip)[0, frame][valid], clip.rgb[0, frame][valid]
    owner = owners(renderer.components(scene, frame), points, renderer.model.config.model.table)
    clouds = {0: _cloud(points[owner == 0], colours[owner == 0])}
    for place, name in enumerate(scene.ids):
        mine = owner == place + 1
        local = (points[mine] - scene.center[frame, place]) @ scene.rotation[frame, place]
        clouds[name] = _cloud(local, colours[mine])
    return clouds


def owners(components: list[Component], points: Float[Tensor, "point 3"], floor: float | None) -> Int[Tensor, "point"]:
    """Index of the densest component at each world point, as in segmentation (paper, section Decoder)."""
    logits = points.new_full((len(components), len(points)), OUTSIDE)
    for place, component in enumerate(components):
        at = in_box(component, points)
        inside = torch.ones(len(points), dtype=torch.bool)
        if component.bounded:
            inside = (at.abs() <= 1).all(dim=-1)
            inside = inside if floor is None else inside & (points[:, 2] > floor)
        logits[place, inside] = component.field.density(at[inside], component.codes)[0]
    return logits.argmax(dim=0)


def slot_colour(name: int) -> tuple[int, int, int]:
    """Colour of an object's name, as in pictures of segmentations."""
    r, g, b = colours_of(np.array(name)).tolist()
    return r, g, b


def tinted(cloud: Cloud, name: int) -> UInt8[np.ndarray, "point 3"]:
    """Mix the observed colours with the colour of an object's name."""
    mixed = (1 - TINT) * cloud.colours + TINT * np.array(slot_colour(name))
    return mixed.astype(np.uint8)


def _cloud(points: Float[Tensor, "point 3"], colours: Float[Tensor, "point 3"]) -> Cloud:
    return Cloud(points.numpy(), to_bytes(colours))
