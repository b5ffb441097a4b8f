"""What encoding 20 images of 64x64 costs, in CPU time of one thread."""

import time
from collections.abc import Iterator

import pytest
import torch
from pytest_benchmark.fixture import BenchmarkFixture

from obpose.config import BackboneConfig
from obpose.model.backbone import Backbone, BackboneOutput

GROUP = "backbone: 20 images at 64x64"
SPACING = 0.012


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_forward(benchmark: BenchmarkFixture):
    backbone, clouds = prepared()
    with torch.no_grad():
        benchmark(lambda: encode(backbone, clouds))


@pytest.mark.benchmark(group=GROUP, timer=time.process_time)
def test_forward_and_backward(benchmark: BenchmarkFixture):
    backbone, clouds = prepared()
    benchmark(lambda: encode(backbone, clouds).embedding.sum().backward())


def prepared() -> tuple[Backbone, tuple[torch.Tensor, torch.Tensor, torch.Tensor]]:
    generator = torch.Generator().manual_seed(0)
    steps = SPACING * torch.arange(64)
    points = torch.rand((20, 64, 64, 3), generator=generator) * 0.03
    points[..., 0] = steps
    points[..., 1] = steps[:, None]
    rgb = torch.rand(points.shape, generator=generator)
    return Backbone(BackboneConfig()), (points, rgb, torch.rand((20, 64, 64), generator=generator) > 0.05)


def encode(backbone: Backbone, clouds: tuple[torch.Tensor, torch.Tensor, torch.Tensor]) -> BackboneOutput:
    return backbone(*clouds, spacing=SPACING, center=torch.zeros(3))
