"""The pattern of a scene's table, found in its frames: what they show that the background's field leaves out.

An addition. That field is one for all tables and smooth; wood, checks and the glow of a lamp are not in it. What is the
same in all frames belongs to the table. Shadows of a known light are taken out before; where none is known, what is
darker around objects than elsewhere is taken for shadows. What only some frames show counts little: shadows of what was
not found, and edges of objects.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from obpose.model.obpose import ObPose
from obpose.scenes.appearance.background_pixels import Shown, occlusion_where_shown, shown_background
from obpose.scenes.appearance.light import strength
from obpose.scenes.appearance.table_texture import EDGE, Pattern, no_pattern, on_pattern, pattern_at
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene
from obpose.types import Observation

_ROUNDS = 4
"""Of splatting what is left on the pattern, which make it sharp, and tell outliers."""
_USUAL = 0.15
"""Logits; what is left of most pixels is less, and pixels of which more is left count less (a Cauchy likelihood)."""
_PULL = 0.05
"""Towards the median, in pixels: where hardly anything of the table was seen."""
_LIT, _ODD = 0.98, 0.05
"""Where the table is seen with less of its light, logits are within those of the others but for such a share at each
end."""
_AROUND = 0.75
"""So many edges of a box from an object's middle, seen from above, there may be shadows of it if no light is known."""
_DARK = 0.02
"""Colours are at least so far from black and white where logits are taken."""


@torch.no_grad()
def find_pattern(model: ObPose, observation: Observation, scene: Scene) -> Pattern:
    """The pattern with which a scene's background is what the frames show, but for shadows.

    Args:
        model: That the scene is of.
        observation: A batch of the clip that the scene is fitted to.
        scene: As it is without a pattern, and with the light that was found.
    """
    # Pixels at outlines show a little of the object.
    shown = shown_background(model, observation, scene, margin=1)
    places, on_table = on_pattern(model, shown.point)
    shown, places = shown.at(on_table), places[on_table]
    lit = torch.ones_like(shown.seen[:, 0])
    if strength(scene.light):
        lit -= strength(scene.light) * occlusion_where_shown(Renderer(model), scene, shown, scene.light[:3])
        in_light = lit > _LIT
    else:
        in_light = _from_objects(scene, shown) > _AROUND * model.config.model.pose.box_size
    wanted = _logit(shown.seen / lit[:, None]) - _logit(shown.drawn)
    if not bool(in_light.any()):
        return no_pattern(scene.center)
    # Shadows are not drawn as they are to the last pixel, and what is left of them is no pattern.
    low, middle, high = wanted[in_light].quantile(wanted.new_tensor([_ODD, 0.5, 1 - _ODD]), dim=0)
    wanted = torch.where(in_light[:, None], wanted, wanted.clamp(low, high))
    pattern, weight = no_pattern(scene.center) + middle, lit.square()
    for number in range(_ROUNDS):
        rest = wanted - pattern_at(model, pattern, shown.point)
        usual = 1.0 if number == 0 else 1 / (1 + (rest / _USUAL).square().mean(dim=-1))
        shares = (weight * usual)[:, None]
        spread = _smooth(_splat(places, torch.cat([shares * rest, shares], dim=-1)), _blur(model))
        pattern = pattern + spread[..., :3] / (spread[..., 3:] + _PULL)
    return pattern


def _from_objects(scene: Scene, shown: Shown) -> Float[Tensor, " pixel"]:
    """Metres from the pixels' points to the nearest middle of an object, seen from above; far where there is none."""
    apart = (shown.point[:, None, :2] - scene.center[shown.frame, :, :2]).norm(dim=-1)
    return F.pad(apart, (0, 1), value=math.inf).amin(dim=-1)


def _logit(colour: Float[Tensor, "pixel 3"]) -> Float[Tensor, "pixel 3"]:
    return torch.logit(colour, eps=_DARK)


def _blur(model: ObPose) -> float:
    """Half as far as pixels of training lie apart, in points of the pattern."""
    return model.config.model.spacing / 2 * (EDGE - 1) / model.config.model.workspace_size


def _splat(places: Float[Tensor, "pixel 2"], values: Float[Tensor, "pixel value"]) -> Float[Tensor, "edge edge value"]:
    """Sums of values at points of a pattern, those of a pixel shared among the four around it (-1..1)."""
    steps = ((places + 1) * ((EDGE - 1) / 2)).clamp(0, EDGE - 1)
    low = steps.floor().clamp(max=EDGE - 2)
    upper = steps - low
    total = values.new_zeros(EDGE * EDGE, values.shape[1])
    for x, share_x in ((0, 1 - upper[:, 0]), (1, upper[:, 0])):
        for y, share_y in ((0, 1 - upper[:, 1]), (1, upper[:, 1])):
            index = (low[:, 0].long() + x) * EDGE + low[:, 1].long() + y
            total.index_add_(0, index, values * (share_x * share_y)[:, None])
    return total.unflatten(0, (EDGE, EDGE))


def _smooth(values: Float[Tensor, "edge edge value"], blur: float) -> Float[Tensor, "edge edge value"]:
    """A Gaussian of this standard deviation, in points."""
    reach = math.ceil(3 * blur)
    kernel = torch.exp(-0.5 * (torch.arange(-reach, reach + 1).to(values) / blur).square())
    kernel = kernel / kernel.sum()
    planes = values.permute(2, 0, 1)[:, None]
    planes = F.conv2d(planes, kernel[None, None, :, None], padding=(reach, 0))
    return F.conv2d(planes, kernel[None, None, None, :], padding=(0, reach))[:, 0].permute(1, 2, 0)
