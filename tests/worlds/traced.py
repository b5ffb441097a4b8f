"""Datasets of spheres over a plane, ray-traced here in a few lines: a world simple enough to know every answer."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from datagen import config, geometry, schema
from datagen.storage import shard, spec

CAMERA_HEIGHT = 0.8
RADIUS = 0.05


def write_dataset(
    folder: Path,
    *,
    scenes: int | dict[str, int] = 3,
    frames: int = 4,
    views: int = 1,
    size: tuple[int, int] = (64, 48),
    spheres: int = 3,
    sensor: bool = False,
    **changes: Any,
) -> Path:
    """A dataset folder with that many scenes in every split, or in each by name; `size` is width and height."""
    facts = {"frames": frames, "views": views, "resolution": size, "sensor": config.Sensor(enabled=sensor)}
    recipe = spheres_recipe(**facts, **changes)
    splits = (
        dict.fromkeys(schema.SPLITS, scenes) if isinstance(scenes, int) else dict.fromkeys(schema.SPLITS, 0) | scenes
    )
    facts = spec.make_spec(
        config.recipe_to_dict(recipe),
        seed=0,
        splits=splits,
        resolution=size,
        renderer={"name": "spheres", "version": 1},
    )
    folder.mkdir(parents=True)
    (folder / spec.SPEC_FILE).write_text(json.dumps(facts))
    for number, split in enumerate(schema.SPLITS):
        if not splits[split]:
            continue
        packed = [shard.pack(scene_record(recipe, [number, i], spheres)) for i in range(splits[split])]
        said = {"data_version": facts["data_version"], "settings_hash": spec.settings_hash(facts)}
        image = shard.shard_image(packed, {**said, "split": split, "first_scene": 0})
        (folder / spec.shard_name(split, 0)).write_bytes(image)
    return folder


def spheres_recipe(**changes: Any) -> config.Recipe:
    """Sizes of a fabricated dataset."""
    return config.Recipe(**{"name": "spheres", "frames": 4, "resolution": (64, 48), **changes})


def scene_record(recipe: config.Recipe, seed: list[int], spheres: int) -> schema.SceneRecord:
    """Spheres on a grid, each 0.2 m from the next, that slide 1 cm a frame."""
    rng = np.random.default_rng(seed)
    width, height = recipe.resolution
    k = np.stack([geometry.intrinsics(np.radians(60), width, height)] * recipe.views)
    angles = 2 * np.pi * np.arange(recipe.views) / recipe.views
    poses = np.stack(
        [geometry.look_at(np.array([0.6 * np.cos(a), 0.6 * np.sin(a), CAMERA_HEIGHT]), np.zeros(3)) for a in angles]
    )
    cells = np.array([(x, y) for x in (-0.2, 0.0, 0.2) for y in (-0.2, 0.0, 0.2)])
    starts = np.column_stack([rng.permutation(cells)[:spheres], np.full(spheres, 0.9 * RADIUS)])
    images = [
        [trace(starts + np.array([0.01 * frame, 0, 0]), k[v], poses[v], width, height) for v in range(recipe.views)]
        for frame in range(recipe.frames)
    ]
    depth, ids = (np.array([[view[part] for view in frame] for frame in images]) for part in (0, 1))
    rgb = np.stack([50 * ids, 200 - 30 * ids, rng.integers(0, 255, ids.shape)], axis=-1).astype(np.uint8)
    record = {
        "rgb": rgb,
        "depth": schema.encode_depth(depth),
        "segmentation": ids.astype(np.uint8),
        "camera/K": k,
        "camera/world_from_camera": poses,
    }
    if recipe.sensor.enabled:
        valid = rng.random(depth.shape) > 0.2
        noisy = np.where(valid, depth + rng.normal(0, 0.001, depth.shape), 0)
        record |= {"sensor_depth": schema.encode_depth(noisy), "sensor_valid": valid.astype(np.uint8)}
    return record


def trace(
    centers: np.ndarray, k: np.ndarray, world_from_camera: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """Planar depth (metres) and ids of spheres with `RADIUS` at `centers` over the plane z = 0."""
    rays = geometry.pixel_rays(k, width, height) @ world_from_camera[:3, :3].T
    origin = world_from_camera[:3, 3]
    depths = [-origin[2] / rays[..., 2]]
    for center in centers:
        a, b = np.sum(rays**2, axis=-1), rays @ (origin - center)
        root = b * b - a * (np.sum((origin - center) ** 2) - RADIUS**2)
        depths.append(np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf))
    return np.min(depths, axis=0), np.argmin(depths, axis=0)
