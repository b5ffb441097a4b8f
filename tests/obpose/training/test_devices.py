import subprocess
import sys

import pytest
import torch

from obpose.config import TrainConfig
from obpose.errors import UsageError
from obpose.training.devices import make_fabric, mean_over_processes, noise_of

CPU = torch.device("cpu")

FAULTS = """
import resource
import torch
from obpose.training.devices import keep_memory

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(5):
        blocks = [torch.ones(2**20) for _ in range(40)]
        del blocks
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

before = faults()
keep_memory()
faults()
print(before, faults())
"""
"""Prints how many pages are asked of the system for five times 160 MiB, without and with kept memory."""


def test_noise_differs_between_seeds_steps_and_processes_and_is_repeated_exactly():
    def draw(**changes: int) -> torch.Tensor:
        values = {"step": 3, "seed": 0, "process": 0} | changes
        return torch.rand(4, generator=noise_of(**values, device=CPU))

    assert torch.equal(draw(), draw())
    for change in ({"step": 4}, {"seed": 1}, {"process": 1}):
        assert not torch.equal(draw(), draw(**change))


def test_one_process_agrees_with_itself():
    fabric = make_fabric("cpu", TrainConfig())
    assert fabric.device == CPU
    values = torch.tensor([1.0, 2.0])
    assert torch.equal(mean_over_processes(fabric, values), values)


@pytest.mark.parametrize(("device", "message"), [("tpu", "Unknown device 'tpu'"), ("cuda", "finds no GPU")])
def test_a_device_that_is_not_there_is_refused(device: str, message: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UsageError, match=message):
        make_fabric(device, TrainConfig())


def test_mixed_precision_is_refused_on_a_cpu():
    with pytest.raises(UsageError, match=r"train\.precision=bf16-mixed needs a GPU"):
        make_fabric("cpu", TrainConfig(precision="bf16-mixed"))


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mallopt is of the GNU C library")
def test_kept_memory_is_not_asked_for_again():
    output = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True, check=True, timeout=120)
    without, kept = map(int, output.stdout.split())
    assert kept < without / 10
