"""Where a training computes: Lightning Fabric for device, precision and several processes."""

import ctypes
import os

import numpy as np
import torch
from jaxtyping import Float
from lightning_fabric import Fabric
from lightning_fabric.strategies.ddp import DDPStrategy
from torch import Tensor

from obpose.config import TrainConfig
from obpose.errors import UsageError

_MEMORY = {-1: 2**31 - 1, -2: 2**26, -3: 2**25}
"""Options of mallopt(3): never trim; grow by 64 MiB; blocks under 32 MiB, the most it takes, come from the heap."""


def make_fabric(device: str, config: TrainConfig) -> Fabric:
    """One process, or those that `torchrun` started, each on a device of its own.

    Raises:
        UsageError: there is no such device, or it cannot compute with this precision.
    """
    accelerator = _accelerator(device)
    if accelerator == "cpu" and config.precision != "32-true":
        raise UsageError(f"train.precision={config.precision} needs a GPU; expected 32-true on a CPU.")
    processes, here = (int(os.environ.get(name, 1)) for name in ("WORLD_SIZE", "LOCAL_WORLD_SIZE"))
    if processes == 1:
        return Fabric(accelerator=accelerator, devices=1, precision=config.precision)
    # Warm-up trains some parameters only, and the others get no gradient.
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


def leave() -> None:
    """Part from the other processes, if there are any.

    What does that at the end of the interpreter comes too late for the threads of gloo: now and then they end a process
    that has done its work with an abort.
    """
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


def keep_memory() -> None:
    """Let a GNU C library keep freed memory: to ask for it anew costs a tenth to a third of a step on a CPU."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    for parameter, value in _MEMORY.items():
        mallopt(parameter, value)


def noise_of(step: int, *, seed: int, process: int, device: torch.device) -> torch.Generator:
    """The noise of one step in one process: nothing about it has to be saved for a run to go on exactly."""
    number = np.random.SeedSequence([seed, 2, step, process]).generate_state(1)[0]
    return torch.Generator(device).manual_seed(int(number))


def mean_over_processes(fabric: Fabric, values: Float[Tensor, " value"]) -> Float[Tensor, " value"]:
    """The values, averaged over all processes."""
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
