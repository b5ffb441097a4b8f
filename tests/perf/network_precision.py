"""CPU time to train the contact model's network on one core: float32, bfloat16, and torch.compile if there is g++.

python -m tests.perf.network_precision
"""

import shutil
import statistics
import time
from collections.abc import Callable

import torch
from torch import Tensor

from obpose.contact.network import UNet

BATCH = 16
ROUNDS = 15


def main() -> None:
    """Print the medians of a forward and backward pass, all ways in turn."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    for side in (32, 48):
        network = UNet(11, 21)
        half = UNet(11, 21).to(torch.bfloat16)
        images = torch.randn(BATCH, 11, side, side)
        ways: dict[str, Callable[[], Tensor]] = {
            "float32": lambda network=network, images=images: network(images),
            "bfloat16": lambda half=half, images=images: half(images.bfloat16()),
            "autocast": lambda network=network, images=images: _autocast(network, images),
        }
        if shutil.which("g++"):
            compiled = torch.compile(network, dynamic=False)
            ways["torch.compile"] = lambda compiled=compiled, images=images: compiled(images)
        first = {name: _cost(way) for name, way in ways.items()}
        costs = {name: [] for name in ways}
        for _ in range(ROUNDS):
            for name, way in ways.items():
                costs[name].append(_cost(way))
        medians = {name: statistics.median(cost) for name, cost in costs.items()}
        for name, median in medians.items():
            print(
                f"{side}x{side} {name}: {1000 * median:.0f} ms, {medians['float32'] / median:.2f} times as fast; "
                f"first pass {first[name]:.1f} s"
            )


def _autocast(network: UNet, images: Tensor) -> Tensor:
    with torch.autocast("cpu", torch.bfloat16):
        return network(images)


def _cost(way: Callable[[], Tensor]) -> float:
    start = time.process_time()
    way().float().square().mean().backward()
    return time.process_time() - start


if __name__ == "__main__":
    main()
