"""Estimation of the texture of a scene's table: the difference of the frames from the smooth background field.

Not in the paper. The background field is shared by all tables; it has no wood, no checks and no glow of a lamp.
Differences that all frames share belong to the table. Shadows of a known light are removed first. Without a known
light, unexplained dark regions near objects are excluded. Differences in only some frames have a low weight.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from obpose.model.obpose import ObPose
from obpose.scenes.appearance.background_pixels import occlusion_where_shown, shown_background
from obpose.scenes.appearance.light import strength
from obpose.scenes.appearance.table_texture import EDGE, Texture, no_texture, on_texture, texture_at
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene
from obpose.types import Observation

_ROUNDS = 4
"""Rounds of splatting residuals onto the texture, which sharpen it and identify outliers."""
_USUAL = 0.15
"""Scale of the Cauchy likelihood of residuals, logits; pixels with larger residuals count less."""
_PULL = 0.05
"""Weight of the median, in pixels, for regions of the table that were hardly seen."""
_LIT, _ODD = 0.98, 0.05
"""Pixels with less than this share of the light are in shadow. Their logits are clamped to the range of the others, of
which this share is ignored at each end."""
_AROUND = 0.75
"""Horizontal reach of possible shadows from the centre of an object, in box edges, if no light is known."""
_DARK = 0.02
"""Least distance of colours from black and white before logits are taken."""


@torch.no_grad()
def find_texture(model: ObPose, observation: Observation, scene: Scene) -> Texture:
    """Estimate the texture that makes a scene's background look like the frames, except for shadows.

    The scene has its light and no texture yet; the observation is a batch of its clip.
    """
    # Pixels at outlines show a little of the object.
    shown = shown_background(model, observation, scene, margin=1)
    places, on_table = on_texture(model, shown.point)
    shown, places = shown.at(on_table), places[on_table]
    lit = torch.ones_like(shown.seen[:, 0])
    if strength(scene.appearance.light):
        lit -= strength(scene.appearance.light) * occlusion_where_shown(
            Renderer(model), scene, shown, scene.appearance.light[:3]
        )
        in_light = lit > _LIT
    else:
        # Horizontal distances to the nearest centre of an object; infinite without objects.
        apart = (shown.point[:, None, :2] - scene.center[shown.frame, :, :2]).norm(dim=-1)
        in_light = F.pad(apart, (0, 1), value=math.inf).amin(dim=-1) > _AROUND * model.config.model.pose.box_size
    wanted = torch.logit(shown.seen / lit[:, None], eps=_DARK) - torch.logit(shown.drawn, eps=_DARK)
    if not bool(in_light.any()):
        return no_texture(scene.center)
    # Rendered shadows are not exact to the pixel; their residuals do not belong to the texture.
    low, middle, high = wanted[in_light].quantile(wanted.new_tensor([_ODD, 0.5, 1 - _ODD]), dim=0)
    wanted = torch.where(in_light[:, None], wanted, wanted.clamp(low, high))
    texture, weight = no_texture(scene.center) + middle, lit.square()
    # Half the spacing of training pixels, in points of the texture.
    blur = model.config.model.spacing / 2 * (EDGE - 1) / model.config.model.workspace_size
    for number in range(_ROUNDS):
        rest = wanted - texture_at(model, texture, shown.point)
        usual = 1.0 if number == 0 else 1 / (1 + (rest / _USUAL).square().mean(dim=-1))
        shares = (weight * usual)[:, None]
        spread = _smooth(_splat(places, torch.cat([shares * rest, shares], dim=-1)), blur)
        texture = texture + spread[..., :3] / (spread[..., 3:] + _PULL)
    return texture


def _splat(places: Float[Tensor, "pixel 2"], values: Float[Tensor, "pixel value"]) -> Float[Tensor, "edge edge value"]:
    """Sum values at the points of a texture; each pixel (-1..1) is shared among the four points around it."""
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
    """Blur with a Gaussian of this standard deviation, in points."""
    reach = math.ceil(3 * blur)
    kernel = torch.exp(-0.5 * (torch.arange(-reach, reach + 1).to(values) / blur).square())
    kernel = kernel / kernel.sum()
    planes = values.permute(2, 0, 1)[:, None]
    planes = F.conv2d(planes, kernel[None, None, :, None], padding=(reach, 0))
    return F.conv2d(planes, kernel[None, None, None, :], padding=(0, reach))[:, 0].permute(1, 2, 0)
