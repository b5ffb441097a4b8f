"""Time that a training step waits for data, in milliseconds of one core: times are CPU times."""

import resource
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import Tensor
from torch.utils.data import DataLoader, RandomSampler, default_collate

from datagen.config import load_recipe
from datagen.pipeline.generate import generate
from datagen.storage.reader import Dataset
from datagen.storage.shard import pack
from datagen.storage.spec import compression_of
from obpose.data.datasets import SceneDataset

CLIPS = 16
GOAL_FRAMES = 3000


@pytest.fixture(scope="module", params=["gzip", "lz4"])
def moving(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    folder = tmp_path_factory.mktemp("data") / "moving"
    settings = {"splits": {"train": CLIPS}, "resolution": (128, 128), "compression": request.param}
    generate(folder, load_recipe("moving"), **settings)
    return folder


@pytest.fixture
def one_thread() -> Iterator[None]:
    """As in a loader's worker."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.benchmark(group="reading: a batch of 16 clips of 4 frames at 128x128", timer=time.process_time)
def test_scene_dataset(benchmark: BenchmarkFixture, moving: Path):
    def open_anew() -> tuple[tuple[SceneDataset], dict[str, object]]:
        # Files that stay open keep unpacked frames, and the next round would read nothing.
        return (SceneDataset(moving, frames=4, window="random"),), {}

    def read(dataset: SceneDataset) -> dict[str, Tensor]:
        return default_collate([dataset[i] for i in range(CLIPS)])

    batch = benchmark.pedantic(read, setup=open_anew, rounds=30, warmup_rounds=2)
    assert batch["rgb"].shape == (CLIPS, 4, 1, 128, 128, 3)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("workers", [0, 1, 2])
def test_frames_per_second_of_cpu_time(moving: Path, workers: int):
    """At random, from open files in the page cache; the time of the workers counts, their start included."""
    dataset = SceneDataset(moving, frames=4, window="random")
    sampler = RandomSampler(dataset, replacement=True, num_samples=200 * CLIPS)
    start, frames = _cpu_seconds(), 0
    for batch in DataLoader(dataset, CLIPS, sampler=sampler, num_workers=workers):
        frames += batch["rgb"].shape[0] * batch["rgb"].shape[1]
    rate = frames / (_cpu_seconds() - start)
    # Not asserted: next to other work it is missed (docs/performance.md).
    print(f"\n{workers} workers: {rate:.0f} frames per second of CPU time (goal {GOAL_FRAMES})")


def test_size_and_time_of_compression(moving: Path):
    dataset = Dataset(moving)
    record = dataset.split("train")[0]
    frames, costs = len(record["rgb"]), []
    for _ in range(20):
        start = time.process_time()
        pack(record, compression_of(dataset.spec))
        costs.append(time.process_time() - start)
    size = sum(path.stat().st_size for path in moving.glob("*.h5")) / CLIPS / frames / 1024
    print(f"\n{size:.1f} KiB per frame; {1000 * statistics.median(costs) / frames:.2f} ms to hash and compress one")


def _cpu_seconds() -> float:
    """CPU time of this process and of those children that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)
