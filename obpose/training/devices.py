"""Device, precision and processes of a training, with Lightning Fabric."""

import ctypes
import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from jaxtyping import Float
from lightning_fabric import Fabric
from lightning_fabric.strategies.ddp import DDPStrategy
from torch import Tensor

from obpose.config import TrainConfig
from obpose.errors import UsageError
from obpose.random_streams import training_seed

_MEMORY = {-1: 2**31 - 1, -2: 2**26, -3: 2**25}
"""Options of mallopt(3): never trim; grow by 64 MiB; allocate blocks under 32 MiB, the maximum, on the heap."""


def make_fabric(device: str, config: TrainConfig) -> Fabric:
    """Set up this process, or all processes of `torchrun`, each with its own device.

    Raises:
        UsageError: there is no such device, or it does not support the precision.
    """
    accelerator = _accelerator(device)
    if accelerator == "cpu" and config.precision != "32-true":
        raise UsageError(f"train.precision={config.precision} needs a GPU; expected 32-true on a CPU.")
    processes, here = (int(os.environ.get(name, 1)) for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"))
    if processes == 1:
        return Fabric(accelerator=accelerator, devices=1, precision=config.precision)
    # In the warm-up, only some parameters get a gradient.
    strategy = DDPStrategy(
        find_unused_parameters=True, process_group_backend="gloo" if accelerator == "cpu" else "nccl"
    )
    return Fabric(
        accelerator=accelerator,
        devices=here,
        num_nodes=processes // here,
        strategy=strategy,
        precision=config.precision,
    )


@contextmanager
def process_group() -> Iterator[None]:
    """Destroy the process group at the end, if there is one.

    At the exit of the interpreter it would be too late: threads of gloo sometimes abort a finished process.
    """
    try:
        yield
    finally:
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            torch.distributed.destroy_process_group()


def keep_memory() -> None:
    """Let the GNU C library keep freed memory, which saves a tenth to a third of the time of a step on a CPU."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    for parameter, value in _MEMORY.items():
        mallopt(parameter, value)


def noise_of(step: int, *, seed: int, process: int, device: torch.device) -> torch.Generator:
    """Generator of the noise of a step in a process, so that a run resumes exactly without saved generator states."""
    return torch.Generator(device).manual_seed(training_seed(seed, "noise", step, process))


def mean_over_processes(fabric: Fabric, values: Float[Tensor, " value"]) -> Float[Tensor, " value"]:
    """Average values over all processes."""
    if fabric.world_size == 1:
        return values
    reduced = fabric.all_reduce(values.to(fabric.device), reduce_op="mean")
    assert isinstance(reduced, Tensor)
    return reduced


def _accelerator(device: str) -> str:
    if device not in ("auto", "cpu", "cuda"):
        raise UsageError(f"Unknown device {device!r}; expected auto, cpu or cuda.")
    if device == "cuda" and not torch.cuda.is_available():
        raise UsageError("PyTorch finds no GPU; use --device cpu, or install a build of PyTorch for your GPU.")
    return "cuda" if device != "cpu" and torch.cuda.is_available() else "cpu"
