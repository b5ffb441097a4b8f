"""Train obpose-contact, the default of obpose-train, for a minute and segment a test clip with it.

python examples/2_train_and_segment.py DATASET RUN [--minutes 1]

DATASET is a folder that example 1 or obpose-datagen made. A minute on few clips only shows that it runs.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np

from benchmark.metrics import clip_scores
from obpose.data.clips import observation_of
from obpose.data.datasets import SceneDataset
from obpose.storage.checkpoint import load_obpose


def main(dataset: Path, run: Path, *budget: str) -> None:
    """Train, load the weights, segment the first test clip and score it."""
    command = Path(sys.executable).with_name("obpose-train")
    subprocess.run([command, "--data", dataset, "--out", run, *(budget or ("--minutes", "1"))], check=True)

    model = load_obpose(run)
    clip = SceneDataset(dataset, "test", extra=["segmentation"])[0]
    found = model.segment(observation_of([clip]))  # a batch of one clip
    labels = found.labels[0].numpy()  # [frame, view, height, width]; 0 is the background

    truth = clip["segmentation"].numpy()
    scores = clip_scores(truth, labels, background_slot=0)  # one value per frame and view
    print(f"Test clip 0: labels {np.unique(labels)}, ARI-FG {np.nanmean(scores['ari_fg']):.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
