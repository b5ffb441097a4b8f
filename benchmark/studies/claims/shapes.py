"""The voxel estimate of an object's shape (paper, end of section Decoder): right, and how fast?

Right is what the generator's exact solids say; fast is meant against volume rendering, which the paper avoids.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor

from benchmark.studies.claims.scenes import Account
from obpose.geometry import all_rays
from obpose.model.nerf.components import points_in_boxes, scatter
from obpose.model.nerf.compose import OUTSIDE
from obpose.model.nerf.render import render
from obpose.model.nerf.voxels import Voxels, occupied_voxels, shape_of
from obpose.types import Decoded

SAMPLES = 64
"""Points along a ray, as in the coarse pass of Mildenhall et al. 2020."""
RAYS = 256
"""Rendered together."""
DENSE = 300.0
"""sigma_max of the rendering, per metre: what is solid hides what is behind it."""
FINE = 24
"""S of the authors."""


@dataclass(frozen=True)
class ShapeErrors:
    """Of one object in one frame. Centres in metres."""

    iou: float
    """Of the occupied voxels with those whose centre lies in the object, with the model's S."""
    fine_iou: float
    """With the authors' S."""
    voxels: float
    """Distance of T_shape from the middle of the object's bounding box; infinite where too few are occupied."""
    predicted: float
    """Of T_hat, which learns T_shape."""
    observed: float
    """Of T, the mean of the observed points."""
    rendered: float
    """Of the middle of the points that volume rendering shows of the object; infinite where it shows none."""


@dataclass(frozen=True)
class Times:
    """CPU seconds a clip."""

    voxels: float
    rendering: float
    """All pixels and components, with colours."""
    objects_alone: float
    """Densities of the objects within their boxes alone."""


@torch.no_grad()
def shape_errors(account: Account) -> list[ShapeErrors]:
    """Of all objects that a slot follows, in all frames where it does."""
    inference = account.segmentation.inference
    coarse, fine = estimate_voxels(account, account.model.config.model.voxels), estimate_voxels(account, FINE)
    shape, rendered = shape_of(coarse), _rendered_centers(account)
    centers = shape.center.masked_fill(~shape.found[..., None], torch.inf)[0]
    errors = []
    for found in account.found:
        for frame in found.frames:
            at = (frame, found.slot)
            truth = account.scene.center(found.row, frame)
            places = [centers[at], inference.boxes.center[0][at], inference.observed_center[0][at], rendered[at]]
            ious = [_iou(account, voxels, found.row, *at) for voxels in (coarse, fine)]
            errors.append(ShapeErrors(*ious, *((place - truth).norm().item() for place in places)))
    return errors


@torch.no_grad()
def measure_times(account: Account, *, rounds: int = 3) -> Times:
    """Of one clip, medians."""
    resolution = account.model.config.model.voxels
    return Times(
        _seconds(lambda: shape_of(estimate_voxels(account, resolution)), rounds),
        _seconds(lambda: _render(account, _everything(account)), rounds),
        _seconds(lambda: _render(account, _objects_alone(account)), rounds),
    )


def estimate_voxels(account: Account, resolution: int) -> Voxels:
    """With S = `resolution`, a point in the middle of each, in all frames."""
    model, inference = account.model, account.segmentation.inference
    return occupied_voxels(
        model.object_field,
        inference.boxes,
        inference.masks.active,
        inference.what.z,
        account.scene.observation,
        resolution=resolution,
    )


def _iou(account: Account, voxels: Voxels, row: int, frame: int, slot: int) -> float:
    estimate = voxels.occupied[0, frame, slot]
    truth = account.scene.occupied(row, frame, voxels.points[0, frame, slot])
    return ((estimate & truth).sum() / (estimate | truth).sum().clamp(min=1)).item()


def _rendered_centers(account: Account) -> Float[Tensor, "frame slot 3"]:
    """Middle of the bounding box of the surface that rendering shows of each slot."""
    rays = all_rays(account.scene.observation)
    depth, weights = _render(account, _everything(account))
    surface = (rays.origin + rays.direction * depth[..., None])[0, :, None]
    shown = (weights[0, :, 1:] > 0.5)[..., None]
    low = surface.masked_fill(~shown, torch.inf).amin(dim=-2)
    high = surface.masked_fill(~shown, -torch.inf).amax(dim=-2)
    return torch.where(shown.any(dim=-2), (low + high) / 2, torch.inf)


def _render(
    account: Account, decode: Callable[[Tensor, Tensor], Decoded]
) -> tuple[Float[Tensor, "batch frame ray"], Float[Tensor, "batch frame component ray"]]:
    """Depths and weights of all pixels, between the least and the largest depth that was observed."""
    rays = all_rays(account.scene.observation)
    seen = rays.depth[rays.valid]
    limits = {"near": seen.min().item(), "far": seen.max().item() + 0.05}
    # All at once would take gigabytes.
    some = zip(rays.origin.split(RAYS, dim=2), rays.direction.split(RAYS, dim=2), strict=True)
    parts = [render(decode, *part, **limits, samples=SAMPLES, sigma_max=DENSE) for part in some]
    return torch.cat([part.depth for part in parts], dim=-1), torch.cat([part.weights for part in parts], dim=-1)


def _everything(account: Account) -> Callable[[Tensor, Tensor], Decoded]:
    inference = account.segmentation.inference
    return lambda points, directions: account.model.decode(inference, points, directions, "with")


def _objects_alone(account: Account) -> Callable[[Tensor, Tensor], Decoded]:
    model, inference = account.model, account.segmentation.inference

    def decode(points: Tensor, directions: Tensor) -> Decoded:
        inside = points_in_boxes(points, inference.boxes, inference.masks.active, floor=model.config.model.table)
        codes = model.object_field.condition(rearrange(inference.what.z, "b f s d -> (b f s) d")).at(inside.owner)
        logits, _ = model.object_field.density(inside.points, codes)
        shape = (*inference.what.z.shape[:3], points.shape[2])
        return Decoded(scatter(logits, inside.index, shape, OUTSIDE), points.new_zeros(()).expand(*shape, 3))

    return decode


def _seconds(call: Callable[[], object], rounds: int) -> float:
    times = []
    for _ in range(rounds):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return median(times)
