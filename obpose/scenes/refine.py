"""Refinement of a scene: latents, positions and details are fitted to the frames by gradient descent.

Not in the paper: semi-amortised inference (Kim et al. 2018). The paper infers latents once and has no details.
"""

from collections.abc import Callable
from dataclasses import replace

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
"""100 steps converge within seconds on one core."""
RAYS, RAYS_OF_CLIP, LEAST_RAYS = 512, 5120, 32
"""Rays per frame and step, largest number per clip, and least number per frame. Half of them hit objects."""
LATENT_STEP, PLACE_STEP, DETAIL_STEP = 0.05, 5e-4, 0.1
"""Initial learning rates of Adam (Kingma and Ba 2015), which decay to 0; the second is in metres."""
AIR = 10.0
"""Factor on the training weight of the air loss, as for `obpose-contact`."""
NEIGHBOURS, SIZE = 2.6, 4.0
"""Prior of details: standard deviations of differences between neighbouring points, and of the values, in logits."""


def refine(model: ObPose, observation: Observation, scene: Scene, *, steps: int) -> Scene:
    """Fit latents, positions and details of a scene by gradient descent on the observation loss.

    The objective per pixel is the negative log-likelihood plus the negative log of the details' prior. Rotations and
    the model's weights are not changed. The result is deterministic, up to rounding.

    The observation is a batch of one clip, with as many frames as the scene. 0 steps change nothing.
    """
    loss, noise = model.config.loss, torch.Generator().manual_seed(0)
    # Adam with a rate for each kind of value, and cosine decay.
    start = (scene.what, scene.background, scene.center, scene.appearance.detail)
    leaves = [value.clone().requires_grad_() for value in start]
    rates = (LATENT_STEP, LATENT_STEP, PLACE_STEP, DETAIL_STEP)
    optimiser = torch.optim.Adam([{"params": [leaf], "lr": rate} for leaf, rate in zip(leaves, rates, strict=True)])
    fall = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, max(1, steps))
    # Half of the rays show objects, which cover few pixels.
    decoding, pixels = fields_of(model, _with(scene, leaves)), max(1, int(observation.valid.sum()))
    shown = _shows_objects(observation, decoding)
    count = max(LEAST_RAYS, min(RAYS, RAYS_OF_CLIP // scene.frames))
    with torch.enable_grad():
        for _ in range(steps):
            rays = sample_rays_where(observation, count, shown, share=0.5, generator=noise)
            # L_obs (paper, eq. 9) and the smoothness of the details.
            terms = observation_terms(fields_along(rays, decoding, noise), loss)
            total = terms["colour"] + terms["surface"] + AIR * terms["air"]
            total = total + roughness(leaves[-1], neighbours=NEIGHBOURS, size=SIZE) / pixels
            for leaf, slope in zip(leaves, torch.autograd.grad(total, leaves), strict=True):
                leaf.grad = slope
            optimiser.step()
            fall.step()
    return _with(scene, [leaf.detach() for leaf in leaves])


def _with(scene: Scene, values: list[Tensor]) -> Scene:
    what, background, center, detail = values
    return replace(scene, what=what, background=background, center=center).with_appearance(detail=detail)


def fields_of(model: ObPose, scene: Scene) -> Callable[..., Decoded]:
    """Give the function of densities and colours of a scene's components at points along rays (`decode`)."""
    frames, objects = scene.what.shape[:2]
    owner = torch.arange(objects).repeat(frames)
    active = torch.ones(1, objects, dtype=torch.bool)

    def at(
        points: Float[Tensor, "1 frame ray 3"],
        directions: Float[Tensor, "1 frame ray 3"],
        colours: Colours,
        where_background: Background = "everywhere",
    ) -> Decoded:
        boxes = Boxes(scene.center[None], scene.rotation[None], model.config.model.pose.box_size)
        detail = Detail(scene.appearance.detail, owner)
        codes = Codes(active, scene.what[None], scene.background[None], boxes, detail)
        return decode(model.fields, codes, points, directions, colours=colours, where_background=where_background)

    return at


@torch.no_grad()
def _shows_objects(
    observation: Observation, decoding: Callable[..., Decoded]
) -> Float[Tensor, "1 frame view height width"]:
    """Mark pixels with 1 if an object is denser than the background at the observed surface, otherwise 0."""
    rays = all_rays(observation)
    points = rays.origin + rays.direction * rays.depth[..., None]
    logits = decoding(points, rays.direction, "without", "in boxes").logits
    return (logits.argmax(dim=2) > 0).view(observation.depth.shape).to(observation.depth.dtype)
