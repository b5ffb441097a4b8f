"""A scene fitted to its frames: latents and places go on by gradient from where the encoders leave them.

An addition: semi-amortised inference (Kim et al. 2018). The paper reads latents once.
"""

from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from obpose.geometry import sample_rays
from obpose.losses.objective import observation_terms
from obpose.model import ObPose
from obpose.nerf.along import fields_along
from obpose.types import Inference, Observation

RAYS = 1024
"""Of each frame in each step."""
LATENT_STEP, PLACE_STEP = 0.05, 5e-4
"""Learning rates of Adam (Kingma and Ba 2015), the second in metres."""


def refine(model: ObPose, observation: Observation, inference: Inference, *, steps: int) -> Inference:
    """Latents of objects and background and the boxes' places after so many steps down the observation loss.

    Boxes are not turned, and the masks stay what they were. The model keeps its weights. What comes out depends on the
    arguments alone.
    """
    assert inference.background is not None
    loss, noise = model.config.loss, torch.Generator(observation.depth.device).manual_seed(0)
    start = (inference.what.z, inference.background.z, inference.boxes.center)
    what, background, center = leaves = [value.detach().clone().requires_grad_() for value in start]
    optimiser = torch.optim.Adam(
        [{"params": [what, background], "lr": LATENT_STEP}, {"params": [center], "lr": PLACE_STEP}]
    )
    air = loss.air * loss.air_growth
    with torch.enable_grad():
        for _ in range(steps):
            decode = partial(model.decode, _moved(inference, what, background, center), boxes="free")
            terms = observation_terms(fields_along(sample_rays(observation, RAYS, noise), decode, loss, noise), loss)
            total = loss.colour * terms["colour"] + loss.surface * terms["surface"] + air * terms["air"]
            for leaf, slope in zip(leaves, torch.autograd.grad(total, leaves), strict=True):
                leaf.grad = slope
            optimiser.step()
    return _moved(inference, *(leaf.detach() for leaf in leaves))


def _moved(inference: Inference, what: Tensor, background: Tensor, center: Tensor) -> Inference:
    assert inference.background is not None
    return replace(
        inference,
        what=replace(inference.what, z=what),
        background=replace(inference.background, z=background),
        boxes=replace(inference.boxes, center=center),
    )
