"""Rays and surface points of pixels, and coordinates in the objects' boxes."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from typing import ParamSpec, TypeVar

import torch
from einops import rearrange, repeat
from jaxtyping import Float, Int
from torch import Tensor

from obpose.types import Boxes, Observation, RayPoints, Rays

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def full_precision(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorator for geometry, which half precision would round to a percent of the scene's size."""

    @wraps(function)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        device = next(value.device.type for value in (*args, *kwargs.values()) if isinstance(value, Tensor))
        with torch.autocast(device, enabled=False):
            return function(*args, **kwargs)

    return run


Places = Float[Tensor, "*#shape point 3"]
Centers = Float[Tensor, "*#shape 3"]
Rotations = Float[Tensor, "*#shape 3 3"]

_DEPTH_OF_NOTHING = 1.0
"""Depth in metres of rays without one, which no loss counts."""
_TINY = 1e-12
"""Unnormalised sampling probability of pixels without depth or interest."""


def unproject(observation: Observation) -> Float[Tensor, "batch frame view height width 3"]:
    """Surface points of all pixels, world frame, metres; 0 where there is no depth (paper, section Encoder)."""
    directions, origins = _camera_rays(observation)
    points = origins[:, None, :, None, None] + directions[:, None] * observation.depth[..., None]
    return points * observation.valid[..., None]


def view_directions(observation: Observation) -> Float[Tensor, "batch view height width 3"]:
    """Directions from the camera to each pixel's surface, world frame, per metre of planar depth."""
    return _camera_rays(observation)[0]


@full_precision
def camera_rays(
    k: Float[Tensor, "*view 3 3"], world_from_camera: Float[Tensor, "*view 4 4"], height: int, width: int
) -> tuple[Float[Tensor, "*view height width 3"], Float[Tensor, "*view 3"]]:
    """Directions through pixel centres, per metre of planar depth, and camera centres; world frame."""
    u = torch.arange(width, dtype=k.dtype, device=k.device) + 0.5
    v = torch.arange(height, dtype=k.dtype, device=k.device) + 0.5
    focal, middle = torch.stack([k[..., 0, 0], k[..., 1, 1]], dim=-1), k[..., :2, 2]
    x = ((u - middle[..., :1]) / focal[..., :1])[..., None, :].expand(*k.shape[:-2], height, width)
    y = ((v - middle[..., 1:]) / focal[..., 1:])[..., :, None].expand(*k.shape[:-2], height, width)
    in_camera = torch.stack([x, y, torch.ones_like(x)], dim=-1)
    rotation, origin = world_from_camera[..., :3, :3], world_from_camera[..., :3, 3]
    return torch.einsum("...ij,...hwj->...hwi", rotation, in_camera), origin


def all_rays(observation: Observation) -> Rays:
    """Rays of all pixels of all views."""
    batch, frame, view, height, width = observation.depth.shape
    index = torch.arange(view * height * width, device=observation.depth.device)
    return _rays(observation, repeat(index, "ray -> batch frame ray", batch=batch, frame=frame))


def sample_rays(observation: Observation, count: int, generator: torch.Generator | None) -> Rays:
    """Draw `count` different pixels of each frame, over all its views; 0 for all.

    Pixels without depth are drawn only if a frame has too few with depth.
    """
    pixels = observation.depth[0, 0].numel()
    if count == 0 or count >= pixels:
        return all_rays(observation)
    # Valid pixels have priorities above 1.
    priority = torch.rand((*observation.depth.shape[:2], pixels), generator=generator, device=observation.depth.device)
    priority = priority + rearrange(observation.valid, "b f view height width -> b f (view height width)")
    return _rays(observation, priority.topk(count, dim=-1, sorted=False).indices)


def sample_rays_where(
    observation: Observation,
    count: int,
    interest: Float[Tensor, "batch frame view height width"],
    *,
    share: float,
    generator: torch.Generator | None,
) -> Rays:
    """Draw `count` pixels of each frame, a `share` of them in proportion to the interest, the others uniformly.

    Importance sampling with replacement: weighted means estimate means over all pixels, and weights are at most
    1 / (1 - share). A count of 0 gives all pixels.
    """
    pixels = observation.depth[0, 0].numel()
    if count == 0 or count >= pixels:
        return all_rays(observation)
    flat = "batch frame view height width -> (batch frame) (view height width)"
    # Frames without any depth need samples, too; their weight is 0.
    valid = rearrange(observation.valid, flat).to(interest.dtype).clamp(min=_TINY)
    # A diverged model has interests of NaN, from which nothing can be drawn; its losses reveal it later.
    interesting = valid * rearrange(interest, flat).nan_to_num().clamp(min=_TINY)
    probability = (1 - share) * _normalised(valid) + share * _normalised(interesting)
    index = probability.multinomial(count, replacement=True, generator=generator)
    weight = _normalised(valid).gather(1, index) / probability.gather(1, index)
    batch = {"batch": observation.depth.shape[0]}
    rays = _rays(observation, rearrange(index, "(batch frame) ray -> batch frame ray", **batch))
    weight = rearrange(weight, "(batch frame) ray -> batch frame ray", **batch)
    return replace(rays, weight=weight * rays.valid)


@full_precision
def to_box(points: Places, center: Centers, rotation: Rotations, size: float) -> Places:
    """Object-frame coordinates, in -1..1 within the box (paper, eq. 6): 2/s R^-1 (p - T)."""
    return (points - center[..., None, :]) @ rotation * (2 / size)


@full_precision
def from_box(points: Places, center: Centers, rotation: Rotations, size: float) -> Places:
    """World coordinates of points in a box: the inverse of `to_box`."""
    return points @ rotation.mT * (size / 2) + center[..., None, :]


def sides_of_points(
    points: Float[Tensor, "batch frame view height width 3"],
    labels: Int[Tensor, "batch frame view height width"],
    boxes: Boxes,
) -> Float[Tensor, "batch frame slot 3"]:
    """Sides of the smallest boxes around the points of labels 1 on, with the centres and axes of `boxes`, metres.

    nan for labels without points.
    """
    flat, owner = (rearrange(array, "b f v h w ... -> b f (v h w) ...") for array in (points, labels))
    sides = []
    for slot in range(boxes.center.shape[2]):
        local = torch.einsum("bfpi,bfij->bfpj", flat - boxes.center[:, :, slot, None], boxes.rotation[:, :, slot])
        mine = (owner == slot + 1)[..., None]
        reach = local.abs().masked_fill(~mine, -torch.inf).amax(dim=2)
        sides.append(2 * reach.masked_fill(reach.isinf(), torch.nan))
    return torch.stack(sides, dim=2)


def _camera_rays(
    observation: Observation,
) -> tuple[Float[Tensor, "batch view height width 3"], Float[Tensor, "batch view 3"]]:
    return camera_rays(observation.k, observation.world_from_camera, *observation.depth.shape[-2:])


def _rays(observation: Observation, index: Tensor) -> Rays:
    directions, origins = _camera_rays(observation)
    height, width = observation.depth.shape[-2:]
    flat = "batch frame view height width -> batch frame (view height width)"
    depth = rearrange(observation.depth, flat).gather(-1, index)
    valid = rearrange(observation.valid, flat).gather(-1, index)
    colour = rearrange(observation.rgb, "b f v h w c -> b f (v h w) c")
    frames = index.shape[1]
    every = repeat(directions, "b v h w c -> b frame (v h w) c", frame=frames)
    origin = repeat(origins, "b v c -> b frame v c", frame=frames)
    return Rays(
        index=index,
        valid=valid,
        weight=valid.to(depth.dtype),
        colour=_pick(colour, index),
        origin=_pick(origin, index // (height * width)),
        direction=_pick(every, index),
        depth=torch.where(valid, depth, _DEPTH_OF_NOTHING),
    )


def _pick(values: Float[Tensor, "batch frame place 3"], index: Tensor) -> RayPoints:
    return values.gather(-2, repeat(index, "b f ray -> b f ray 3"))


def _normalised(values: Float[Tensor, "image pixel"]) -> Float[Tensor, "image pixel"]:
    return values / values.sum(dim=-1, keepdim=True)
