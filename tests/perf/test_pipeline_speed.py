"""The whole pipeline, `moving` at 128x128 from sampling to the file, and reading it back.

Times of one core are CPU times. Two workers against one is wall time, so it needs an idle machine, and is not asserted.
"""

import time
from pathlib import Path
from typing import Any

import pytest

from datagen.config import load_recipe, recipe_to_dict
from datagen.pipeline.generate import Run, generate
from datagen.pipeline.make_scene import SceneMaker, renderer_identity
from datagen.storage.atomic import write_atomically
from datagen.storage.reader import Dataset
from datagen.storage.shard import shard_image
from datagen.storage.spec import make_spec

MOVING = load_recipe("moving")
SCENES = 48
BATCH = ["rgb", "depth", "segmentation", "camera/K", "camera/world_from_camera"]
GOAL_FRAMES, GOAL_READ, GOAL_BYTES, GOAL_RATIO = 100, 0.025, 15 * 1024, 1.7
seconds: dict[str, float] = {}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    generate(folder, MOVING, splits={"train": 64}, run=Run(workers=2))
    return folder


@pytest.mark.benchmark(group="pipeline: 10 frames of 128x128, to the file", timer=time.process_time)
def test_one_core(benchmark: Any, tmp_path: Path):
    renderer = renderer_identity("raster")
    make = SceneMaker(make_spec(recipe_to_dict(MOVING), seed=0, splits={}, resolution=(128, 128), renderer=renderer))
    made = [make("val", 0)]

    def next_scene() -> None:
        made.append(make("train", len(made)))

    benchmark.pedantic(next_scene, rounds=SCENES)
    start = time.process_time()
    write_atomically(tmp_path / "shard.h5", shard_image(made[1:], {}))
    writing = (time.process_time() - start) / SCENES
    frames = MOVING.frames / (benchmark.stats.stats.mean + writing)
    print(
        f"\n{frames:.0f} frames/s a core (goal {GOAL_FRAMES}), {1e6 * writing / MOVING.frames:.0f} us a frame to write"
    )
    assert frames >= GOAL_FRAMES


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.benchmark(group="pipeline: 400 scenes with one and two workers, wall time")
def test_workers(benchmark: Any, tmp_path: Path, workers: int):
    def run() -> None:
        generate(tmp_path, MOVING, splits={"train": 400}, run=Run(workers=workers))

    benchmark.pedantic(run, rounds=1)
    seconds[str(workers)] = benchmark.stats.stats.mean
    if workers == 2 and "1" in seconds:
        print(f"\ntwo workers are {seconds['1'] / seconds['2']:.2f} times as fast as one (goal {GOAL_RATIO})")


@pytest.mark.benchmark(group="reading: a batch of 16 clips of 4 frames at 128x128", timer=time.process_time)
def test_batch(benchmark: Any, dataset: Path):
    def read() -> None:
        scenes = Dataset(dataset).split("train")
        for index in range(0, 64, 4):
            scenes.read(index, BATCH, slice(index % 6, index % 6 + 4))
        scenes.close()

    benchmark.pedantic(read, rounds=40, warmup_rounds=2)
    print(f"\n{1000 * benchmark.stats.stats.median:.1f} ms a batch, the file opened anew (goal {1000 * GOAL_READ:.0f})")
    assert benchmark.stats.stats.median <= GOAL_READ


def test_bytes_per_frame(dataset: Path):
    size = sum(path.stat().st_size for path in dataset.glob("*.h5")) / (64 * MOVING.frames)
    print(f"\n{size / 1024:.1f} KiB a frame on disk (goal {GOAL_BYTES / 1024:.0f})")
    assert size <= GOAL_BYTES
