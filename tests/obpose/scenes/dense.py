"""Pictures of scenes without leaving anything out: the fields of all slots at all samples."""

import torch

from obpose.geometry import camera_rays
from obpose.model.nerf.compose import OUTSIDE
from obpose.model.nerf.marching import Component, in_box
from obpose.model.nerf.render import Rendering, render
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Camera, Scene
from obpose.types import Decoded

RAYS = 512
"""At once."""
AXES = {"colour": 2, "depth": 2, "weights": 3}


@torch.no_grad()
def densely(renderer: Renderer, scene: Scene, camera: Camera, *, behind: float = 0.0) -> Rendering:
    """The first frame; colours are those of so many more metres of planar depth, which costs a second evaluation."""
    components, floor = renderer.components(scene, 0), renderer.model.config.model.table
    assert floor is not None

    def everywhere(points: torch.Tensor, directions: torch.Tensor) -> Decoded:
        return _decode(components, points[0, 0], directions[0, 0], floor, behind)

    direction, origin = camera_rays(camera.k, camera.world_from_camera, camera.height, camera.width)
    along = {name: value for name, value in renderer.quadrature(camera).items() if name != "behind"}
    parts = [
        render(everywhere, origin.expand_as(some)[None, None], some[None, None], **along)
        for some in direction.flatten(0, 1).split(RAYS)
    ]
    return Rendering(*(torch.cat([getattr(part, name) for part in parts], dim=axis) for name, axis in AXES.items()))


def _decode(
    components: list[Component], points: torch.Tensor, directions: torch.Tensor, floor: float, behind: float
) -> Decoded:
    logits, colours = [], []
    for component in components:
        at = in_box(component, points)
        logit, hidden = component.field.density(at, component.codes)
        outside = (at.abs() > 1).any(dim=-1) | (points[:, 2] <= floor)
        logits.append(logit.masked_fill(outside, OUTSIDE) if component.bounded else logit)
        if behind:
            _, hidden = component.field.density(in_box(component, points + behind * directions), component.codes)
        unit = torch.nn.functional.normalize(directions, dim=-1) @ component.rotation
        colours.append(component.field.colour(hidden, unit, component.codes))
    return Decoded(torch.stack(logits)[None, None], torch.stack(colours)[None, None])
