"""Pixels of a clip that show the background, with the colours of the scene's background there."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from obpose.geometry import all_rays
from obpose.model.nerf.along import JITTER
from obpose.model.obpose import ObPose
from obpose.scenes.refine import fields_of
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene
from obpose.types import Observation


@dataclass(frozen=True, eq=False)
class Shown:
    """Pixels that show the background."""

    point: Float[Tensor, "pixel 3"]
    """Surface points, world frame, metres."""
    frame: Int[Tensor, " pixel"]
    seen: Float[Tensor, "pixel 3"]
    """Colour in the frames."""
    drawn: Float[Tensor, "pixel 3"]
    """Colour of the scene's background, without texture and shadows."""

    def at(self, index: Int[Tensor, " some"] | slice | Bool[Tensor, " pixel"]) -> "Shown":
        """Select some of the pixels."""
        return Shown(self.point[index], self.frame[index], self.seen[index], self.drawn[index])


@torch.no_grad()
def shown_background(model: ObPose, observation: Observation, scene: Scene, *, margin: int = 0) -> Shown:
    """Find pixels at whose surface no object is denser than the background, in and near the workspace.

    The scene has no light and no texture; the observation is a batch of its clip. `margin` is the least distance from
    other pixels, in pixels along both axes of the images.
    """
    rays = all_rays(observation)
    surface = rays.origin + rays.direction * rays.depth[..., None]
    behind = JITTER / 2 * rays.direction
    decoded = fields_of(model, scene)(surface + behind, rays.direction, "with")
    assert decoded.colours is not None
    near = ((surface - model.center).abs() <= model.config.model.workspace_size).all(dim=-1)
    shown = (decoded.logits.argmax(dim=2) == 0) & rays.valid & near
    images = (~shown).view(observation.depth.shape).to(surface.dtype).flatten(0, 2)
    shown = (F.max_pool2d(images[:, None], 2 * margin + 1, stride=1, padding=margin) == 0).view_as(shown)
    frame = torch.arange(scene.frames)[None, :, None].expand(shown.shape)
    return Shown(surface[shown], frame[shown], rays.colour[shown], decoded.colours[:, :, 0][shown])


def occlusion_where_shown(
    renderer: Renderer, scene: Scene, shown: Shown, toward: Float[Tensor, "3"]
) -> Float[Tensor, " pixel"]:
    """Compute the share of the light from a direction that objects keep from the pixels."""
    occluded = torch.zeros_like(shown.seen[:, 0])
    for frame in shown.frame.unique().tolist():
        here = shown.frame == frame
        occluded[here] = renderer.occlusion(renderer.objects(scene, frame), shown.point[here], toward)
    return occluded
