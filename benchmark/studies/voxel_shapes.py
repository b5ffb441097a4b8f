"""Is the voxel estimate of an object's shape accurate, and is it faster than volume rendering?

The estimate (paper, end of section Decoder) is compared with the generator's exact shapes. Rendering is what the paper
avoids by it.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite, nan
from statistics import mean, median

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor

from benchmark.ranking.leaderboard import Line
from benchmark.studies.inputs import InferredClip, ModelFlags, TableFlags, infer_clips
from obpose.geometry import all_rays
from obpose.model.nerf.components import points_in_boxes, scatter
from obpose.model.nerf.compose import OUTSIDE
from obpose.model.nerf.render import render
from obpose.model.nerf.voxels import Voxels, occupied_voxels, shape_of
from obpose.types import Decoded

SAMPLES = 64
"""Points per ray, as in the coarse pass of Mildenhall et al. (2020)."""
RAYS = 256
"""Rays rendered at once; all of them would take gigabytes."""
DENSE = 300.0
"""sigma_max of the rendering, per metre: solid matter hides what is behind it."""
FINE = 24
"""Voxels per edge (S) in the authors' code."""

Decode = Callable[[Tensor, Tensor], Decoded]


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags, TableFlags):
    """Options of the study."""


def run(flags: Flags) -> Iterator[Line]:
    """Summarise errors over all followed objects and frames, and CPU times of the first clip."""
    flags.check(scenes=1)
    clips = list(infer_clips(flags.origin().model, flags.folder(), flags.split, flags.scenes))
    errors = [error for clip in clips for error in shape_errors(clip)]
    objects, followed = sum(clip.truth.count for clip in clips), sum(len(clip.followed) for clip in clips)
    print(f"{followed} of {objects} objects of {len(clips)} scenes are followed by a slot, in {len(errors)} frames.")
    for name in errors[0] if errors else ():
        yield summary(name, [error[name] for error in errors])
    for name, seconds in measure_times(clips[0]).items():
        yield summary(f"CPU seconds, {name}", seconds)


def summary(name: str, values: Sequence[float]) -> Line:
    """Summarise the finite values."""
    known = [value for value in values if isfinite(value)]
    averages = {"median": median(known), "mean": mean(known)} if known else {"median": nan, "mean": nan}
    return {"what": name, **averages, "undefined": len(values) - len(known)}


@torch.no_grad()
def shape_errors(clip: InferredClip) -> Iterator[dict[str, float]]:
    """Compare voxels and centres with the truth, for each followed object and frame; metres, infinite if undefined."""
    inference, size = clip.segmentation.inference, clip.model.config.model.voxels
    voxels = estimate_voxels(clip, size)
    estimates = {f"IoU, S = {size}": voxels, f"IoU, S = {FINE} (authors)": estimate_voxels(clip, FINE)}
    shape = shape_of(voxels)
    centers = {
        "distance of T_shape, centre of the voxels": shape.center.masked_fill(~shape.found[..., None], torch.inf)[0],
        "distance of T_hat, predicted": inference.boxes.center[0],
        "distance of T, mean of the observed points": inference.observed_center[0],
        "distance of the centre of the rendered surface": _rendered_centers(clip),
    }
    for followed in clip.followed:
        for frame in followed.frames:
            at, truth = (frame, followed.slot), true_center(clip, followed.row, frame)
            ious = {name: _iou(clip, estimate, followed.row, *at) for name, estimate in estimates.items()}
            yield ious | {name: (center[at] - truth).norm().item() for name, center in centers.items()}


def true_center(clip: InferredClip, row: int, frame: int) -> Float[Tensor, "3"]:
    """Centre of an object's bounding box along the world's axes, which T_shape estimates."""
    pose = clip.truth.world_from_object[frame, row]
    corners = clip.truth.shapes[row].vertices @ pose[:3, :3].T + pose[:3, 3]
    return torch.from_numpy((corners.min(axis=0) + corners.max(axis=0)) / 2).float()


def estimate_voxels(clip: InferredClip, resolution: int) -> Voxels:
    """Estimate the voxels of all slots in all frames with S = `resolution`."""
    model, inference = clip.model, clip.segmentation.inference
    return occupied_voxels(
        model.object_field,
        inference.boxes,
        inference.masks.active,
        inference.what.z,
        clip.observation,
        resolution=resolution,
    )


@torch.no_grad()
def measure_times(clip: InferredClip, *, rounds: int = 3) -> dict[str, list[float]]:
    """Measure the CPU seconds of voxels and of rendering, several times each."""
    ways = {
        "voxels": lambda: shape_of(estimate_voxels(clip, clip.model.config.model.voxels)),
        "volume rendering of all pixels": lambda: _render(clip, _everything(clip)),
        "densities of the objects in their boxes alone": lambda: _render(clip, _objects_alone(clip)),
    }
    return {name: [_seconds(call) for _ in range(rounds)] for name, call in ways.items()}


def _iou(clip: InferredClip, voxels: Voxels, row: int, frame: int, slot: int) -> float:
    estimate = voxels.occupied[0, frame, slot]
    truth = clip.occupied(row, frame, voxels.points[0, frame, slot])
    return ((estimate & truth).sum() / (estimate | truth).sum().clamp(min=1)).item()


def _rendered_centers(clip: InferredClip) -> Float[Tensor, "frame slot 3"]:
    """Centre of the bounding box of the surface that rendering shows of each slot."""
    rays = all_rays(clip.observation)
    depth, weights = _render(clip, _everything(clip))
    surface = (rays.origin + rays.direction * depth[..., None])[0, :, None]
    shown = (weights[0, :, 1:] > 0.5)[..., None]
    low = surface.masked_fill(~shown, torch.inf).amin(dim=-2)
    high = surface.masked_fill(~shown, -torch.inf).amax(dim=-2)
    return torch.where(shown.any(dim=-2), (low + high) / 2, torch.inf)


def _render(
    clip: InferredClip, decode: Decode
) -> tuple[Float[Tensor, "batch frame ray"], Float[Tensor, "batch frame component ray"]]:
    """Depths and weights of all pixels, between the smallest and the largest observed depth."""
    rays = all_rays(clip.observation)
    seen = rays.depth[rays.valid]
    limits = {"near": seen.min().item(), "far": seen.max().item() + 0.05}
    chunks = zip(rays.origin.split(RAYS, dim=2), rays.direction.split(RAYS, dim=2), strict=True)
    parts = [render(decode, *chunk, **limits, samples=SAMPLES, sigma_max=DENSE) for chunk in chunks]
    return torch.cat([part.depth for part in parts], dim=-1), torch.cat([part.weights for part in parts], dim=-1)


def _everything(clip: InferredClip) -> Decode:
    return lambda points, directions: clip.model.decode(clip.segmentation.inference, points, directions, "with")


def _objects_alone(clip: InferredClip) -> Decode:
    model, inference = clip.model, clip.segmentation.inference

    def decode(points: Tensor, directions: Tensor) -> Decoded:
        inside = points_in_boxes(points, inference.boxes, inference.masks.active, floor=model.config.model.table)
        codes = model.object_field.condition(rearrange(inference.what.z, "b f s d -> (b f s) d")).at(inside.owner)
        logits, _ = model.object_field.density(inside.points, codes)
        shape = (*inference.what.z.shape[:3], points.shape[2])
        return Decoded(scatter(logits, inside.index, shape, OUTSIDE), points.new_zeros(()).expand(*shape, 3))

    return decode


def _seconds(call: Callable[[], object]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start
