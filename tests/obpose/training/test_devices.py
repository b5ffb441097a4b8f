import pytest
import torch

from obpose.config import TrainConfig
from obpose.errors import UsageError
from obpose.training.devices import make_fabric, mean_over_processes, noise_of

CPU = torch.device("cpu")


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
