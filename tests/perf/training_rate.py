"""Training steps per second, and their share of the peak rate of matrix products, on a GPU or a CPU.

python -m tests.perf.training_rate --profile gpu --device cuda --batch 64 --size 128
python -m tests.perf.training_rate --profile gpu --device cpu --batch 1 --size 32 --steps 2    runs everywhere
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import fields
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.flop_counter import flop_registry

from obpose.model.build import build_obpose
from obpose.training.devices import keep_memory, make_fabric
from obpose.training.learner import Learner
from tests.perf.training_step import clips, config_for_clips

PEAK = 4096
"""Side of the square matrices whose product has the peak rate."""


class Counter(TorchDispatchMode):
    """Floating-point operations of matrix products and convolutions."""

    total = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        if count := flop_registry.get(func._overloadpacket):
            self.total += count(*args, **(kwargs or {}), out_val=result)
        return result


def main() -> None:
    """Print steps, clips and operations per second, and the peak."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--variant", default="obpose")
    parser.add_argument("--profile", choices=("cpu", "gpu"), default="gpu")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--steps", type=int, default=20)
    flags = parser.parse_args()
    on_cpu = flags.device == "cpu"
    changes = {"train.batch": flags.batch} | ({"train.precision": "32-true"} if on_cpu else {})
    config = config_for_clips(flags.variant, flags.profile, **changes)
    keep_memory()
    learner = Learner(make_fabric(flags.device, config.train), config, build_obpose)
    seen = clips(flags.batch, flags.size)
    batch = {field.name: getattr(seen, field.name) for field in fields(seen)}

    def step(number: int) -> None:
        learner.step(batch, step=config.train.warmup + number, fraction=0.5, learning_rate=1e-4)

    step(0)
    with Counter() as counter:
        step(1)
    seconds = timed(lambda: [step(2 + number) for number in range(flags.steps)], flags.device) / flags.steps
    dtype = torch.float32 if config.train.precision == "32-true" else torch.bfloat16
    rate, peak = counter.total / seconds, matrix_rate(flags.device, dtype)
    print(
        f"{flags.variant}, profile {flags.profile}, {flags.device}, {config.train.precision}, {flags.batch} clips of "
        f"{flags.size}x{flags.size}: {1 / seconds:.2f} steps/s, {flags.batch / seconds:.1f} clips/s, "
        f"{rate / 1e9:.1f} of {peak / 1e9:.0f} GFLOP/s: {100 * rate / peak:.1f} % of the peak"
    )


def timed(call: Callable[[], object], device: str) -> float:
    """Seconds of a call: CPU time on a CPU, wall time until a GPU is done."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    if device == "cuda":
        torch.cuda.synchronize()
    start = clock()
    call()
    if device == "cuda":
        torch.cuda.synchronize()
    return clock() - start


def matrix_rate(device: str, dtype: torch.dtype) -> float:
    """Floating-point operations per second of a large matrix product."""
    side = PEAK if device == "cuda" else PEAK // 4
    a, b = (torch.randn(side, side, device=device, dtype=dtype) for _ in range(2))
    torch.matmul(a, b)  # warm-up
    return 10 * 2 * side**3 / timed(lambda: [a @ b for _ in range(10)], device)


if __name__ == "__main__":
    main()
