"""Entry point of `obpose-train`: the training command of `obpose`, with the benchmark's ARI-FG as validation score."""

import sys
from typing import TYPE_CHECKING

from datagen.console.command_line import start

if TYPE_CHECKING:
    import numpy as np


def main() -> int:
    """Run `obpose-train` and give its exit code."""
    return start("obpose-train", "obpose.commands.train", score=ari_fg)


def ari_fg(truth: "np.ndarray", labels: "np.ndarray") -> float:
    """Mean ARI-FG over the frames of a clip; nan if it is undefined in all of them."""
    from benchmark.metrics import clip_scores, mean_where_defined  # late: `--version` needs no NumPy

    return mean_where_defined(clip_scores(truth, labels)["ari_fg"])


if __name__ == "__main__":
    sys.exit(main())
