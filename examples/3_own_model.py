"""Plug in a model: compare it with others on a dataset.

python examples/3_own_model.py DATASET RESULTS

A model is a class with fit and segment. This script runs it by hand, saves its masks and lets obpose-bench score them.
Registered as an entry point, obpose-bench runs it by name, in a process of its own: docs/benchmark.md, "A class".
"""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmark.clips import ClipSequence
from benchmark.models.interface import Clip, Prediction
from datagen.storage.reader import Dataset


class DepthBands:
    """Cuts the depth at its quantiles; the farthest band is the background."""

    def __init__(self, slots: int):
        self.slots = slots

    def fit(self, train: Sequence[Clip], val: Sequence[Clip], *, seed: int, budget: float) -> None:
        """Find the cuts; clips carry no labels."""
        depths = np.concatenate([clip.depth[clip.valid] for clip in train])
        self.cuts = np.quantile(depths, np.linspace(0, 0.2, self.slots))[1:]

    def segment(self, clip: Clip) -> Prediction:
        """Label every pixel with the number of its band."""
        return Prediction(np.digitize(-clip.depth, -self.cuts[::-1]), background_slot=0)


def main(dataset: Path, results: Path) -> None:
    """Fit, segment the test split, and score next to training-free models."""
    splits = {name: ClipSequence(Dataset(dataset).split(name)) for name in ("train", "val", "test")}
    model = DepthBands(slots=5)
    model.fit(splits["train"], splits["val"], seed=0, budget=60)

    masks = results / "depth-bands" / "test"
    masks.mkdir(parents=True, exist_ok=True)
    for scene, clip in enumerate(splits["test"]):
        found = model.segment(clip)
        np.savez(masks / f"{scene:05d}.npz", labels=found.labels, background_slot=found.background)

    bench, run = Path(sys.executable).with_name("obpose-bench"), ["--data", dataset, "--out", results / "run"]
    subprocess.run([bench, "--model", "plane-dbscan", "floors", "--seeds", "1", *run], check=True)
    subprocess.run([bench, "--predictions", masks.parent, "--name", "depth-bands", *run], check=True)
    print(f"Report: {results / 'run' / 'report.html'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
