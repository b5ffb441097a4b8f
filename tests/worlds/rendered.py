"""Rendered scenes without physics: objects put on the table by hand, which slide and turn from frame to frame."""

import dataclasses
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from datagen import config, shapes
from datagen.edits import edits_record
from datagen.edits.edit_context import stage_of
from datagen.pipeline import records
from datagen.render import Renderer, make_renderer
from datagen.scene import Body, Camera, Light, Material, Scene, ShapeSpec, Table, Trajectory
from datagen.schema import EditKind, SceneRecord, Signal
from datagen.shapes.shape import MeshSource
from datagen.signals import signals_record
from datagen.storage import manifest, reader, shard, spec

ROWS = 4
GROUPS = ("simulation", "pixels")
BOX = ShapeSpec("box", {"size": [0.12, 0.08, 0.06]})
CYLINDER = ShapeSpec("cylinder", {"radius": 0.03, "height": 0.1})
SPHERE = ShapeSpec("sphere", {"radius": 0.04})
STANDING = [(BOX, (0.2, -0.05, 0.03)), (CYLINDER, (0.3, 0.08, 0.05)), (SPHERE, (0.36, -0.1, 0.04))]

RECIPE = config.Recipe(name="staged", layout=config.Layout(center=(0.28, 0.0), half_extent=(0.12, 0.12), tries=200))
"""Recipe with the place of the objects."""

Standing = Sequence[tuple[ShapeSpec, tuple[float, float, float]]]


def scene(standing: Standing = STANDING, *, frames: int = 3, views: int = 1, table: float = 1.5) -> Scene:
    """Grey objects of the given shapes at the given places."""
    material = Material("rubber", (0.6, 0.4, 0.3))
    bodies = tuple(
        Body(shape.family, shape, material, 800.0, 0.5, 0.1, "slide", place, (1.0, 0.0, 0.0, 0.0))
        for shape, place in standing
    )
    angles = 2 * np.pi * np.arange(views) / views
    cameras = tuple(
        Camera((float(0.28 + 0.59 * np.cos(a)), float(0.59 * np.sin(a)), 0.84), (0.28, 0.0, 0.0), float(np.radians(40)))
        for a in angles
    )
    light = Light((0.36, 0.48, 0.8), (0.8, 0.8, 0.8), 0.04)
    return Scene(bodies, Table(table, material), cameras, (light,), (0.3, 0.3, 0.3), (0.5, 0.6, 0.7), frames, 12.0)


def trajectory(world: Scene) -> Trajectory:
    """Every object slides 4 mm a frame and turns 0.2 radians about z."""
    count, steps = len(world.bodies), np.arange(world.frames)
    start = np.array([body.position for body in world.bodies])
    position = start + steps[:, None, None] * np.array([0.004, 0.0, 0.0])
    angle = np.repeat(0.3 + 0.2 * steps[:, None], count, axis=1)
    turn = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=-1)
    gap = np.full((world.frames, count + 1, count + 1), np.inf)
    gap[:, 0, 1:] = gap[:, 1:, 0] = 0.0
    still = np.zeros((world.frames, count, 3), np.float32)
    return Trajectory(
        position.astype(np.float32),
        turn.astype(np.float32),
        still,
        still,
        gap.astype(np.float32),
        np.zeros_like(gap, np.float32),
    )


def record(
    world: Scene,
    *,
    resolution: tuple[int, int] = (64, 64),
    sensor: bool = False,
    renderer: Renderer | None = None,
    motion: Callable[[Scene], Trajectory] = trajectory,
    edits: Sequence[EditKind] = (),
    signals: Sequence[Signal] = (),
    meshes: MeshSource | None = None,
) -> SceneRecord:
    """All arrays of a staged scene."""
    built = [shapes.build(body.shape, meshes) for body in world.bodies]
    path = motion(world)
    simulated = records.simulation_record(world, built, path, rows=ROWS, attempts=1, rejections={})
    renderer = renderer or make_renderer("raster")
    pixels = records.pixel_record(
        world,
        built,
        path,
        renderer,
        resolution=resolution,
        rows=ROWS,
        sensor=config.Sensor(enabled=sensor),
        rng=np.random.default_rng(0),
    )
    rngs = {kind: np.random.default_rng(number) for number, kind in enumerate(edits)}
    stage = stage_of(world, tuple(built), path)
    edited = edits_record(stage, pixels, RECIPE, renderer, rngs)
    return {**simulated, **pixels, **edited, **signals_record(stage, pixels, signals, np.random.default_rng(0))}


def write_dataset(folder: Path, scenes: Sequence[SceneRecord], *, sensor: bool = False, **settings: Any) -> Path:
    """A dataset folder whose training split holds these scenes; `settings` are of its recipe."""
    frames, views, height, width = scenes[0]["segmentation"].shape
    recipe = config.Recipe(
        name="staged",
        frames=frames,
        views=views,
        resolution=(width, height),
        sensor=config.Sensor(enabled=sensor),
        **settings,
    )
    facts = spec.make_spec(
        config.recipe_to_dict(recipe),
        seed=0,
        splits={"train": len(scenes)},
        resolution=(width, height),
        renderer={"name": "raster", "version": 1},
    )
    folder.mkdir(parents=True, exist_ok=True)
    (folder / spec.SPEC_FILE).write_text(json.dumps(facts))
    for number, indices in enumerate(spec.shard_ranges(len(scenes), facts["scenes_per_shard"])):
        write_shard(folder, facts, "train", number, [shard.pack(scenes[index]) for index in indices])
    write_manifest(folder)
    return folder


def write_shards(folder: Path, number: int, *, linked: bool = False) -> Path:
    """A dataset of so many shards of 64 equal scenes; links are not in their places."""
    written = record(scene(frames=2), resolution=(16, 16))
    write_dataset(folder, [written] * 64)
    facts = spec.with_splits(spec.read_spec(folder), {"train": number * 64})
    (folder / spec.SPEC_FILE).write_text(spec.spec_text(facts))
    first = folder / spec.shard_name("train", 0)
    for place in range(1, number):
        path = folder / spec.shard_name("train", place)
        if linked:
            os.link(first, path)
            continue
        path.write_bytes(first.read_bytes())
        with h5py.File(path, "r+") as file:
            file.attrs.modify("first_scene", place * 64)
    return folder


def change_scene(
    folder: Path, split: str, index: int, change: Callable[[SceneRecord], object], *, keep_hash: bool = False
) -> None:
    """Tamper with one scene of a dataset and make its hash and the manifest fit, unless the old hash is to be kept."""
    dataset = reader.Dataset(folder)
    record = {name: array.copy() for name, array in dataset.split(split)[index].items()}
    change(record)
    changed = shard.pack(record)
    if keep_hash:
        changed = dataclasses.replace(changed, hash=dataset.split(split).hash(index))
    number, row = divmod(index, dataset.spec["scenes_per_shard"])
    old = shard.Shard(folder, dataset.spec, split, number)
    scenes = [changed if i == row else old.packed(i) for i in range(len(old))]
    old.close()
    write_shard(folder, dataset.spec, split, number, scenes)
    write_manifest(folder)


def write_shard(
    folder: Path, facts: spec.Spec, split: str, number: int, scenes: list[shard.PackedScene], /, **changes: object
) -> Path:
    """Write a shard that says of itself what it should, except for `changes`, and give its path."""
    said = {
        "data_version": facts["data_version"],
        "settings_hash": spec.settings_hash(facts),
        "split": split,
        "first_scene": number * facts["scenes_per_shard"],
    }
    path = folder / spec.shard_name(split, number)
    path.unlink(missing_ok=True)  # a new file, as the old one may be open
    path.write_bytes(shard.shard_image(scenes, {**said, **changes}))
    return path


def write_manifest(folder: Path) -> None:
    """The record of a finished dataset, of what is there now."""
    made = spec.read_spec(folder)
    facts = manifest.make_manifest(made, manifest.file_facts(folder, made), seconds=0.0, workers=1, scenes_made=0)
    (folder / spec.MANIFEST_FILE).write_text(json.dumps(facts))
