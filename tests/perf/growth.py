"""Time and memory over the number of scenes and of shards: python -m tests.perf.growth."""

import os
import random
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import TypeVar

from benchmark.machine import resident_mib
from datagen.config import load_recipe, recipe_to_dict
from datagen.pipeline.make_scene import SceneMaker
from datagen.pipeline.shards import shard_tasks
from datagen.schema import SPLITS
from datagen.storage.reader import Dataset
from datagen.storage.shard import Shard
from datagen.storage.spec import make_spec
from tests.worlds.rendered import write_shards

Result = TypeVar("Result")

SHARDS = (10, 100, 1000, 10_000)
SCENES, BLOCK = 2000, 400
READS = 1000
JOBS = 1000


def main() -> None:
    """Print a line for each number of shards, and for each block of scenes."""
    # All shards are links to the first, so that no disk holds a million scenes.
    Shard._check_place = lambda self, spec, split, number: None
    with tempfile.TemporaryDirectory() as place:
        for number in SHARDS:
            shards(write_shards(Path(place) / f"{number}", number, linked=True), number)
    scenes()


def shards(folder: Path, number: int) -> None:
    """Costs that could grow with the number of shards."""
    opened, split = timed(lambda: Dataset(folder).split("train"))
    begun, _ = timed(lambda: shard_tasks(folder, split.spec, SPLITS, (0, JOBS)))
    rng = random.Random(0)

    def read() -> None:
        split.read(rng.randrange(len(split)), ["rgb", "depth", "segmentation"])

    for _ in range(READS // 5):
        read()
    before = resident_mib(os.getpid())
    times = [timed(read)[0] for _ in range(READS)]
    print(
        f"{number:6} shards: open {1e3 * opened:.1f} ms, start one of {JOBS} jobs {1e3 * begun:.1f} ms, random scene "
        f"{1e3 * median(times):.2f} ms, growth over {READS} scenes {resident_mib(os.getpid()) - before:.2f} MiB",
        flush=True,
    )


def scenes() -> None:
    """Costs of a scene as more are made in one process."""
    recipe = {**recipe_to_dict(load_recipe("moving")), "frames": 2}
    renderer = {"name": "raster", "version": 1}
    make = SceneMaker(make_spec(recipe, seed=0, splits={}, resolution=(16, 16), renderer=renderer))
    make("val", 0)

    def make_block(first: int) -> None:
        for index in range(first, first + BLOCK):
            make("train", index)  # not kept

    for first in range(0, SCENES, BLOCK):
        seconds, _ = timed(lambda first=first: make_block(first))
        print(
            f"{first + BLOCK:6} scenes: {1e3 * seconds / BLOCK:.1f} ms a scene, {resident_mib(os.getpid()):.1f} MiB",
            flush=True,
        )


def timed(call: Callable[[], Result]) -> tuple[float, Result]:
    """CPU seconds of a call, and its result."""
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


if __name__ == "__main__":
    main()
