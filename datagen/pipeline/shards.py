"""The shards that a run has to make: finding, making and writing them."""

import threading
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from datagen.console.progress import Advance
from datagen.errors import UsageError
from datagen.pipeline.cluster import connected, refresh_mark, shared_mark
from datagen.pipeline.make_scene import SceneMaker, renderer_identity
from datagen.pipeline.parallel import make_all
from datagen.schema import DATA_VERSION, FIELDS, SPLITS
from datagen.storage.atomic import remove_abandoned
from datagen.storage.dataset_folder import write_file
from datagen.storage.manifest import package_version, write_record
from datagen.storage.shard import PackedScene, Shard, shard_image
from datagen.storage.spec import Spec, groups_of, settings_hash, shard_name, shard_ranges

_ONE_AT_A_TIME = threading.Lock()
"""Held while a thread of a Dask worker makes scenes: there is one physics engine per process."""


@dataclass(frozen=True)
class ShardTask:
    """A shard, with the scenes to keep and to make."""

    split: str
    number: int
    kept: range
    """Scenes to keep from the present file."""
    todo: range
    """Scenes to make."""


Made = Generator[tuple[ShardTask, list[PackedScene] | None]]
"""Tasks with their new scenes, or with None if the shard is already in the folder."""


def shard_tasks(folder: Path, spec: Spec, splits: Sequence[str], share: tuple[int, int]) -> list[ShardTask]:
    """List the shards of some splits that are missing or incomplete; `share` (i, n) picks every n-th shard.

    Only present shards of this share are opened, so that the jobs of an array do not all open the whole dataset.
    """
    part, parts = share
    everything = [
        (split, number, indices)
        for split in SPLITS
        for number, indices in enumerate(shard_ranges(spec["splits"][split], spec["scenes_per_shard"]))
    ]
    tasks: list[ShardTask] = []
    for split, number, indices in everything[part::parts]:
        if split in splits and (kept := _usable_scenes(folder, spec, split, number)) < len(indices):
            tasks.append(ShardTask(split, number, indices[:kept], indices[kept:]))
    return tasks


def _usable_scenes(folder: Path, spec: Spec, split: str, number: int) -> int:
    """Scenes of a shard that hold all fields that a new one would hold; 0 if there is no such shard."""
    if not (folder / shard_name(split, number)).exists():
        return 0
    with closing(Shard(folder, spec, split, number)) as shard:
        shard.check()
        fields = {name for name, field in FIELDS.items() if field.group in groups_of(spec)}
        return len(shard) if set(shard.fields) == fields else 0


def write_shard(folder: Path, spec: Spec, task: ShardTask, new: Sequence[PackedScene]) -> None:
    """Write a shard of kept and new scenes, then its record, from which the manifest is merged.

    A longer shard that another process has written meanwhile stays, for example if a Dask worker still finishes a task
    of a lost client.
    """
    kept: list[PackedScene] = []
    if task.kept:
        with closing(Shard(folder, spec, task.split, task.number)) as shard:
            kept = [shard.packed(row) for row in range(len(task.kept))]
    # The new shard, in memory.
    settings = settings_hash(spec)
    attributes = {
        "data_version": spec["data_version"],
        "settings_hash": settings,
        "split": task.split,
        "first_scene": (task.kept or task.todo).start,
    }
    image = shard_image([*kept, *new], attributes)
    if _usable_scenes(folder, spec, task.split, task.number) > len(kept) + len(new):
        return
    write_file(folder, shard_name(task.split, task.number), image, settings)
    write_record(folder, spec, task.split, task.number)


def make_here(maker: SceneMaker, tasks: Sequence[ShardTask], workers: int, advance: Advance) -> Made:
    """Make shards in order, by processes of this machine that make scenes; calls `advance` for each scene."""
    scenes = [(task.split, index) for task in tasks for index in task.todo]
    with closing(make_all(maker, scenes, workers)) as made:
        for task in tasks:
            new = []
            for scene in islice(made, len(task.todo)):
                new.append(scene)
                advance()
            yield task, new


def make_on_cluster(
    maker: SceneMaker, tasks: Sequence[ShardTask], address: str, folder: Path, advance: Advance
) -> Made:
    """Make shards in any order, by the workers of a Dask cluster; calls `advance` for each scene.

    A worker that shares the dataset's folder writes its shards; others return their scenes to this process.
    """
    with connected(address) as cluster, shared_mark(folder) as mark:
        shared = {"maker": maker.with_absolute_paths(), "mark": mark, "arithmetic": arithmetic_of(maker.spec)}
        for task, new in cluster.map(make_shard, tasks, **shared):
            refresh_mark(mark)
            for _ in task.todo:
                advance()
            yield task, new
    remove_abandoned(folder)  # of workers that were killed while they wrote


def make_shard(task: ShardTask, *, maker: SceneMaker, mark: Path, arithmetic: str) -> list[PackedScene] | None:
    """Make the new scenes of a shard on a worker; returns them unless it could write the shard beside `mark`.

    Raises:
        UsageError: the worker would make other scenes than the client, or does not see the folder of an input.
    """
    if (here := arithmetic_of(maker.spec)) != arithmetic:
        raise UsageError(
            f"A Dask worker would make other scenes: it has {here}; expected {arithmetic}. Install the same "
            "versions of obpose and its libraries there, and start workers with OPENBLAS_CORETYPE=Haswell in their "
            "environment."
        )
    maker.check_inputs()
    with _ONE_AT_A_TIME:
        new = [maker(task.split, index) for index in task.todo]
    if not mark.exists():
        return new
    write_shard(mark.parent, maker.spec, task, new)
    return None


def arithmetic_of(spec: Spec) -> str:
    """Describe what decides the last bits of a scene: data version, libraries, OpenBLAS's kernels and the renderer."""
    from threadpoolctl import threadpool_info

    kernels = {library["architecture"] for library in threadpool_info() if library["internal_api"] == "openblas"}
    libraries = ", ".join(f"{name} {package_version(name)}" for name in ("numpy", "numba", "pybullet"))
    chosen = spec["renderer"] or {}
    renderer = renderer_identity(chosen.get("name"), chosen.get("samples")) or {"name": "none"}
    return (
        f"data version {DATA_VERSION}, {libraries}, OpenBLAS kernels {', '.join(sorted(kernels))} and renderer "
        f"{' '.join(map(str, renderer.values()))}"
    )
