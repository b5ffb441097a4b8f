"""Clips of spheres over a plane, whole and spoiled in known ways."""

import dataclasses

import numpy as np

from benchmark.models.interface import Clip
from datagen import geometry, schema
from tests.worlds.traced import scene_record, spheres_recipe, trace


def clip_of(record: schema.SceneRecord, *, uses_labels: bool = False) -> Clip:
    depth = schema.decode_depth(record["depth"])
    truth = record["segmentation"] if uses_labels else None
    return Clip(record["rgb"], depth, depth > 0, record["camera/K"], record["camera/world_from_camera"], truth)


def clip_and_truth(
    seed: int = 0, spheres: int = 3, *, uses_labels: bool = False, **recipe: object
) -> tuple[Clip, np.ndarray]:
    record = scene_record(spheres_recipe(**recipe), [seed], spheres)
    return clip_of(record, uses_labels=uses_labels), record["segmentation"]


def balls(
    paths: np.ndarray, size: int = 64, eye: tuple[float, float, float] = (0.01, 0.0, 1.0)
) -> tuple[Clip, np.ndarray]:
    """A clip of balls whose centres, metres, go along `paths` (frame, ball, 3), all of one colour; seen from `eye`."""
    k = geometry.intrinsics(np.radians(60), size, size)
    pose = geometry.look_at(np.array(eye), np.zeros(3))
    images = [trace(centers, k, pose, size, size) for centers in paths]
    depth, truth = (np.stack([image[part] for image in images])[:, None] for part in (0, 1))
    rgb = np.full((*truth.shape, 3), 90, np.uint8)
    rgb[truth > 0] = 160
    depth = depth.astype(np.float32)
    return Clip(rgb, depth, depth > 0, k[None], pose[None]), truth


def with_holes(clip: Clip, share: float) -> Clip:
    valid = np.random.default_rng(0).random(clip.depth.shape) >= share
    return dataclasses.replace(clip, depth=np.where(valid, clip.depth, 0).astype(np.float32), valid=valid)


def with_noise(clip: Clip) -> Clip:
    noise = np.random.default_rng(0).normal(0, 0.002, clip.depth.shape)
    return dataclasses.replace(clip, depth=(clip.depth + noise).astype(np.float32))


def turned(clip: Clip, angle: float) -> Clip:
    """Scene in a world that is rotated about z, radians, and moved."""
    quaternion = np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])
    turned_from_world = geometry.rigid(np.array([0.3, -2.0, 1.0]), quaternion)
    return dataclasses.replace(clip, world_from_camera=turned_from_world @ clip.world_from_camera)


def arbitrary(seed: int, *, frames: int = 2, views: int = 2, size: tuple[int, int] = (13, 17)) -> Clip:
    """A clip in which nothing makes sense."""
    rng = np.random.default_rng(seed)
    shape = (frames, views, *size)
    valid = rng.random(shape) > 0.3
    poses = [geometry.look_at(rng.uniform(0.3, 1, 3), np.zeros(3)) for _ in range(views)]
    return Clip(
        rgb=rng.integers(0, 256, (*shape, 3), dtype=np.uint8),
        depth=np.where(valid, rng.uniform(0.1, 3, shape), 0).astype(np.float32),
        valid=valid,
        k=np.stack([geometry.intrinsics(1.0, size[1], size[0])] * views),
        world_from_camera=np.stack(poses),
        truth=rng.integers(0, 5, shape, dtype=np.uint8),
    )
