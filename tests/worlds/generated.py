"""The smallest real datasets: clips of three frames at 32x32, a few scenes."""

import dataclasses
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np

from datagen import schema
from datagen.config import Recipe, load_recipe, recipe_to_dict
from datagen.pipeline.generate import Report, Run, generate
from datagen.storage import spec
from datagen.storage.reader import Dataset
from datagen.storage.safe_io import LZ4_FILTER
from tests.paths import ROOT

RESOLUTION = (32, 32)
FLAGS = ("--recipe", "moving", "--frames", "3", "--resolution", "32x32")
"""Flags of `recipe()` on the command line."""


def recipe(**changes: object) -> Recipe:
    """`moving` with three frames."""
    return dataclasses.replace(load_recipe("moving"), **{"frames": 3, **changes})


def make(
    folder: Path, splits: dict[str, int], *, renderer: str | None = "raster", seed: int = 0, **run: object
) -> Report:
    """A dataset of `recipe()`."""
    resolution = RESOLUTION if renderer else None
    return generate(
        folder, recipe(), splits=splits, seed=seed, resolution=resolution, renderer=renderer, run=Run(**run)
    )


def hashes(folder: Path) -> dict[str, list[str]]:
    """The stored hash of every scene, each checked against its arrays."""
    dataset = Dataset(folder)
    found = {}
    for name, number in dataset.splits.items():
        scenes = dataset.split(name)
        found[name] = [scenes.hash(index) for index in range(number)]
        assert found[name] == [schema.scene_hash(record) for record in scenes]
    return found


def compressions(folder: Path) -> set[str]:
    """Compressions of the images in all shards."""
    found = set()
    for path in folder.glob("*.h5"):
        with h5py.File(path) as file:
            lz4 = file["rgb"].id.get_create_plist().get_filter_by_id(LZ4_FILTER)
            found.add("lz4" if lz4 else file["rgb"].compression)
    return found


def command(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run `obpose-datagen` in its own process."""
    return subprocess.run(
        [sys.executable, "-m", "datagen.commands.entry", *map(str, arguments)],
        cwd=cwd,
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "200"},
        capture_output=True,
        text=True,
    )


def random_spec(*, seed: int = 0, **splits: int) -> spec.Spec:
    """The spec of a dataset whose scenes are of the size of `random_record`; equal seeds are equal settings."""
    small = recipe_to_dict(recipe(views=2))
    renderer = {"name": "raster", "version": 1}
    return spec.make_spec(small, seed=seed, splits=splits, resolution=(7, 5), renderer=renderer)


def random_record(seed: int) -> schema.SceneRecord:
    """Noise in every field of the format: three frames, two views, 7x5 pixels."""
    rng = np.random.default_rng(seed)
    lengths = {
        "frame": 3,
        "view": 2,
        "height": 5,
        "width": 7,
        "channel": 3,
        "light": 2,
        "byte": 1,
        "point": 5,
    }
    lengths |= {"object": 4, "object+1": 5}
    record = {}
    for name, field in schema.FIELDS.items():
        shape = tuple(int(axis) if axis.isdigit() else lengths[axis] for axis in field.axes)
        if field.dtype == "S":
            texts = [b"x" * int(length) for length in rng.integers(0, 30, int(np.prod(shape)))]
            record[name] = np.reshape(np.array(texts), shape)
        else:
            most = 4 if name == "objects/count" else 250
            record[name] = np.asarray(rng.uniform(0, most, shape)).astype(field.dtype)
    return record
