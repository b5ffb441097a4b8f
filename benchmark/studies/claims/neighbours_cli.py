"""How much of a model's error is due to objects that adjoin each other in the image.

python -m benchmark.studies.claims.neighbours_cli RUN/labels/FILE.h5 [...]

The label maps are of the test split; each line of the answer is of one file.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Integer

from benchmark.clips import ClipSequence
from benchmark.metrics import score
from benchmark.results.labels import check_labels, dataset_of, read_labels
from benchmark.studies.claims.command import LabelMaps, run_command
from datagen.errors import EXIT_OK
from datagen.storage.reader import Dataset

PROGRAM = "python -m benchmark.studies.claims.neighbours_cli"
SPLIT = "test"
METRICS = ("ari_fg", "msc_fg")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; give the exit code."""
    return run_command(run, LabelMaps, arguments, program=PROGRAM, about=__doc__)


def run(values: LabelMaps) -> int:
    """Every file in its turn."""
    check_labels(*values.labels)
    print("ARI-FG / MSC-FG in images where no objects adjoin, and where some do")
    for path in values.labels:
        adjoin, scores = images_of(path, values.data or dataset_of(path))
        apart, near = (np.nanmean(scores[kind], axis=0) if kind.any() else [np.nan] * 2 for kind in (~adjoin, adjoin))
        print(f"{path.name}: {apart[0]:.3f} / {apart[1]:.3f}, {near[0]:.3f} / {near[1]:.3f} ({adjoin.mean():.0%})")
    return EXIT_OK


def images_of(path: Path, data: Path) -> tuple[Bool[np.ndarray, " image"], Float64[np.ndarray, "image metric"]]:
    """Of each image with two objects or more: whether some adjoin, and its scores; pixels without depth never count."""
    truths = Dataset(data).split(SPLIT)
    clips = ClipSequence(truths)
    adjoin, scores = [], []
    for index, (labels, background_slot) in enumerate(read_labels(path)):
        arrays = truths.read(index, ("segmentation",))["segmentation"], labels, ~clips[index].valid
        for true, found, unseen in zip(*(array.reshape(-1, 1, *array.shape[2:]) for array in arrays), strict=True):
            if len(np.unique(true[(true > 0) & ~unseen])) > 1:
                adjoin.append(objects_adjoin(true[0]))
                found_scores = score(true, found, background_slot, ignore=unseen)
                scores.append([found_scores[name] for name in METRICS])
    return np.array(adjoin, dtype=bool), np.array(scores).reshape(-1, len(METRICS))


def objects_adjoin(truth: Integer[np.ndarray, "height width"]) -> bool:
    """Whether pixels of two objects lie side by side or one above the other.

    >>> objects_adjoin(np.array([[1, 0, 2], [1, 0, 0]])), objects_adjoin(np.array([[1, 0, 2], [1, 2, 2]]))
    (False, True)
    """
    pairs = (truth[:, 1:], truth[:, :-1]), (truth[1:], truth[:-1])
    return any(bool(((one != other) & (one > 0) & (other > 0)).any()) for one, other in pairs)


if __name__ == "__main__":
    raise SystemExit(main())
