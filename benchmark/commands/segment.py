"""Entry point of `obpose-segment`: the command of `obpose`, with the benchmark's methods without training."""

import sys
from typing import TYPE_CHECKING

from datagen.console.command_line import start

if TYPE_CHECKING:
    from obpose.rgbd.segment import Labels, Method
    from obpose.types import Observation


def main() -> int:
    """Run `obpose-segment` and give its exit code."""
    return start("obpose-segment", "obpose.commands.segment", find_method=find_method)


def find_method(name: str, objects: int = 16) -> "Method":
    """Find a model without training by name, with its default options, for at most so many objects.

    Raises:
        UsageError: there is none.
    """
    from benchmark.models.classical import CLASSICAL, STRONGER  # late: `--version` needs no NumPy
    from benchmark.models.interface import Clip
    from datagen.errors import unknown_name

    methods = {**CLASSICAL, **STRONGER}
    if name not in methods:
        raise unknown_name("method", name, methods)
    spec = methods[name]

    def segment(observation: "Observation") -> "Labels":
        arrays = {
            key: getattr(observation, key)[0].numpy() for key in ("rgb", "depth", "valid", "k", "world_from_camera")
        }
        clip = Clip(**{**arrays, "rgb": (255 * arrays["rgb"]).round().astype("uint8")})
        segmenter = spec.build({"slots": objects + 1, **spec.default})
        segmenter.fit([], [], seed=0, budget=0.0)
        prediction = segmenter.segment(clip)
        labels = prediction.labels + 1
        if prediction.background_slot is not None:
            labels[prediction.labels == prediction.background_slot] = 0
        return labels[:, 0]

    return segment


if __name__ == "__main__":
    sys.exit(main())
