"""Entry point of `obpose-segment`: the command of `obpose`, with the benchmark's methods without training."""

import sys
from functools import partial
from typing import TYPE_CHECKING

from datagen.console.command_line import start

if TYPE_CHECKING:
    from obpose.rgbd.segment import Method


def main() -> int:
    """Run `obpose-segment` and give its exit code."""
    return start("obpose-segment", "obpose.commands.segment", find_method=find_method)


def find_method(name: str, objects: int = 16) -> "Method":
    """Find a model without training by name, with its default options, for at most `objects` objects.

    Raises:
        UsageError: there is none.
    """
    from benchmark.models.adapters.own_frames import segment_observation
    from benchmark.models.classical import CLASSICAL, STRONGER  # late: `--version` needs no NumPy
    from benchmark.models.interface import slots_for_objects
    from datagen.errors import unknown_name

    methods = {**CLASSICAL, **STRONGER}
    if name not in methods:
        raise unknown_name("method", name, methods)
    segmenter = methods[name].build({"slots": slots_for_objects(objects), **methods[name].default})
    segmenter.fit([], [], seed=0, budget=0.0)
    return partial(segment_observation, segmenter)


if __name__ == "__main__":
    sys.exit(main())
