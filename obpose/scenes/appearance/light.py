"""The light that casts a scene's shadows: a distant disc, like the sun.

Not in the paper, whose fields cast no shadows. A light is a tensor: the unit direction from the scene to the light,
world axes, and the share of the background's colour that is lost in its shadow. All values are 0 if there is no light.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

Light = Float[Tensor, "4"]
_RADIUS = 0.06
"""Angle of the directions of `beams` from the centre, radians. It is twice that of a disc of 2.5 degrees, because the
shapes of objects are known only roughly."""
_ROUNDING = 1e-3
"""Largest difference of the length of a direction from 1."""


def no_light(like: Tensor | None = None) -> Light:
    """Give the absence of a light, in the type of `like`."""
    return torch.zeros(4) if like is None else like.new_zeros(4)


def strength(light: Light) -> float:
    """Give the share of the background's colour that is lost in the shadow of a light."""
    return float(light[3])


def beams(toward: Float[Tensor, "3"]) -> Float[Tensor, "beam 3"]:
    """Give directions to parts of the disc of a light, which make its shadows soft."""
    axis = torch.zeros_like(toward).scatter(0, toward.abs().argmin(dim=0, keepdim=True), 1.0)
    across = F.normalize(torch.linalg.cross(toward, axis), dim=0)
    other = torch.linalg.cross(toward, across)
    return F.normalize(toward + _RADIUS * torch.stack([across, other, -across, -other]), dim=-1)


def is_light(light: Light) -> bool:
    """Whether a tensor is a valid light, or the absence of one."""
    share = strength(light)
    if not bool(light.isfinite().all()):
        return False
    return share == 0 or (0 < share <= 1 and abs(float(light[:3].norm()) - 1) <= _ROUNDING)
