"""What a training step waits for, in milliseconds of one core: times are CPU times."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture
from torch import Tensor
from torch.utils.data import default_collate

from datagen.config import load_recipe
from datagen.pipeline.generate import generate
from obpose.data.datasets import SceneDataset

CLIPS = 16


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "moving"
    generate(folder, load_recipe("moving"), splits={"train": CLIPS}, resolution=(128, 128))
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
