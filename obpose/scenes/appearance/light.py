"""The light that casts a scene's shadows: one from far away, as the sun is, and of the sun's kind of edge.

An addition: the paper's fields cast none. As a tensor it is the direction from the scene to the light, of length 1 in
the world's axes, and the share of the background's colour that is lost where this light does not arrive. All is 0 where
no light is known, and there are no shadows.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

Light = Float[Tensor, "4"]
_RADIUS = 0.06
"""How far the directions of `beams` lie from the middle, radians. A disc of 2.5 degrees is on average half as wide; the
rest is for the shapes of objects, which are known roughly."""
_ROUNDING = 1e-3
"""By how much the length of a direction may differ from 1."""


def no_light(like: Tensor | None = None) -> Light:
    """None is known; of the same kind of numbers as `like`."""
    return torch.zeros(4) if like is None else like.new_zeros(4)


def strength(light: Light) -> float:
    """Share of the background's colour that is lost where it does not arrive."""
    return float(light[3])


def beams(toward: Float[Tensor, "3"]) -> Float[Tensor, "beam 3"]:
    """Directions to parts of a light whose middle is there: it is a disc and no point, and its shadows are soft."""
    axis = torch.zeros_like(toward).scatter(0, toward.abs().argmin(dim=0, keepdim=True), 1.0)
    across = F.normalize(torch.linalg.cross(toward, axis), dim=0)
    other = torch.linalg.cross(toward, across)
    return F.normalize(toward + _RADIUS * torch.stack([across, other, -across, -other]), dim=-1)


def is_light(light: Light) -> bool:
    """Whether it is one, or none."""
    share = strength(light)
    if not bool(light.isfinite().all()):
        return False
    return share == 0 or (0 < share <= 1 and abs(float(light[:3].norm()) - 1) <= _ROUNDING)
