"""A scene fitted to its frames: latents, places and details go on by gradient from where the encoders leave them.

An addition: semi-amortised inference (Kim et al. 2018). The paper reads latents once, and has no details.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from obpose.geometry import all_rays, sample_rays_where
from obpose.model.losses.objective import observation_terms
from obpose.model.nerf.along import fields_along
from obpose.model.nerf.components import Background, Codes, Colours, decode
from obpose.model.nerf.detail import Detail, roughness
from obpose.model.obpose import ObPose
from obpose.scenes.scene import Scene
from obpose.types import Boxes, Decoded, Observation

STEPS = 100
"""Are plenty, and take seconds."""
RAYS, RAYS_OF_CLIP, LEAST_RAYS = 512, 5120, 32
"""Of each frame in each step, half of them where objects are; fewer where a clip of many frames would have more in all,
but not less than the last."""
LATENT_STEP, PLACE_STEP, DETAIL_STEP = 0.05, 5e-4, 0.1
"""Learning rates of Adam (Kingma and Ba 2015) at the beginning, from which they fall to 0; the second in metres."""
AIR = 10.0
"""So many times the weight of the air in training: as in that of `obpose-sharp`, which is for pictures."""
NEIGHBOURS, SIZE = 2.6, 4.0
"""Prior of details: standard deviations of differences between neighbouring points of the lattice, and of the values
themselves, logits."""


@dataclass(frozen=True, eq=False)
class _Leaves:
    """What is fitted, as in `Scene`."""

    what: Float[Tensor, "frame object what"]
    background: Float[Tensor, "frame background"]
    center: Float[Tensor, "frame object 3"]
    detail: Float[Tensor, "object edge edge edge 4"]

    def all(self) -> list[Tensor]:
        return [self.what, self.background, self.center, self.detail]


def refine(model: ObPose, observation: Observation, scene: Scene, *, steps: int) -> Scene:
    """The scene with latents, places of objects and details after so many steps down the observation loss.

    With the details' prior it is, for a pixel, minus the log of what is made large. Objects are not turned. The model
    keeps its weights. What comes out depends on the arguments alone, to rounding.

    Args:
        model: That the scene is of.
        observation: A batch of one clip, as many frames as the scene has.
        scene: Where to begin.
        steps: How many; 0 for none.
    """
    loss, noise = model.config.loss, torch.Generator().manual_seed(0)
    start = (scene.what, scene.background, scene.center, scene.detail)
    leaves = _Leaves(*(value.clone().requires_grad_() for value in start))
    rates = (LATENT_STEP, LATENT_STEP, PLACE_STEP, DETAIL_STEP)
    groups = [{"params": [leaf], "lr": rate} for leaf, rate in zip(leaves.all(), rates, strict=True)]
    optimiser = torch.optim.Adam(groups)
    fall = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(1, steps))
    decoding, pixels = _decoding(model, scene, leaves), max(1, int(observation.valid.sum()))
    shown = _shows_objects(observation, decoding)
    count = max(LEAST_RAYS, min(RAYS, RAYS_OF_CLIP // scene.frames))
    with torch.enable_grad():
        for _ in range(steps):
            rays = sample_rays_where(observation, count, shown, share=0.5, generator=noise)
            terms = observation_terms(fields_along(rays, decoding, noise), loss)
            total = terms["colour"] + terms["surface"] + AIR * terms["air"]
            total = total + roughness(leaves.detail, neighbours=NEIGHBOURS, size=SIZE) / pixels
            for leaf, slope in zip(leaves.all(), torch.autograd.grad(total, leaves.all()), strict=True):
                leaf.grad = slope
            optimiser.step()
            fall.step()
    what, background, center, detail = (leaf.detach() for leaf in leaves.all())
    return replace(scene, what=what, background=background, center=center, detail=detail)


def fields_of(model: ObPose, scene: Scene) -> Callable[..., Decoded]:
    """Densities and colours of the scene's components, at points along rays of each frame (`decode`)."""
    return _decoding(model, scene, _Leaves(scene.what, scene.background, scene.center, scene.detail))


def _decoding(model: ObPose, scene: Scene, leaves: _Leaves) -> Callable[..., Decoded]:
    """The scene's fields."""
    frames, objects = scene.what.shape[:2]
    owner = torch.arange(objects).repeat(frames)
    active = torch.ones(1, objects, dtype=torch.bool)

    def at(
        points: Float[Tensor, "1 frame ray 3"],
        directions: Float[Tensor, "1 frame ray 3"],
        colours: Colours,
        where_background: Background = "everywhere",
    ) -> Decoded:
        boxes = Boxes(leaves.center[None], scene.rotation[None], model.config.model.pose.box_size)
        detail = Detail(leaves.detail, owner)
        codes = Codes(active, leaves.what[None], leaves.background[None], boxes, detail)
        return decode(model.fields, codes, points, directions, colours=colours, where_background=where_background)

    return at


@torch.no_grad()
def _shows_objects(
    observation: Observation, decoding: Callable[..., Decoded]
) -> Float[Tensor, "1 frame view height width"]:
    """1 where an object is denser than the background at the observed surface, else 0."""
    rays = all_rays(observation)
    points = rays.origin + rays.direction * rays.depth[..., None]
    logits = decoding(points, rays.direction, "without", "in boxes").logits
    return (logits.argmax(dim=2) > 0).view(observation.depth.shape).to(observation.depth.dtype)
