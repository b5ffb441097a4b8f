"""Which errors does a model make, and when: over time, by number of objects in view, and where objects adjoin?

Reads label maps of test splits, as runs of obpose-bench write them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Bool, Float64, Integer

from benchmark.metrics import score
from benchmark.metrics.errors_by_type import ERROR_TYPES, MEANINGS
from benchmark.ranking.leaderboard import Line
from benchmark.report.analysis import outcome
from benchmark.report.observations import Truth, observe, read_truth
from benchmark.results.labels import check_labels, dataset_of, read_labels
from benchmark.studies.inputs import TableFlags
from datagen.storage.reader import Dataset

SPLIT = "test"
METRICS = ("ari_fg", "msc_fg")


@dataclass(frozen=True, kw_only=True)
class Flags(TableFlags):
    """Options of the study."""

    labels: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Files of label maps of test splits, from the folder `labels` of a run."""
    data: Path | None = None
    """Dataset that was segmented, if it has moved since."""


def run(flags: Flags) -> Iterator[Line]:
    """Measure the errors of each file."""
    check_labels(*flags.labels)
    print("".join(f"{name}: {MEANINGS[name]}\n" for name in ERROR_TYPES))
    for path in flags.labels:
        scenes = Dataset(flags.data or dataset_of(path)).split(SPLIT)
        objects, truths = observe(scenes), [read_truth(scenes, index) for index in range(len(scenes))]
        found = outcome(truths, read_labels(path))
        groups = {
            "all": np.full(len(objects.frame), True),
            "first frames": objects.frame == 0,
            "last frames": objects.frame == objects.frame.max(),
            **{f"{count} in view": objects.companions == count for count in np.unique(objects.companions)},
        }
        for name, group in groups.items():
            shares = dict(zip(ERROR_TYPES, found.errors[group].mean(axis=0).tolist(), strict=True))
            best = float(found.overlap[group].mean())
            yield {"labels": path.stem, "objects in": name, "objects": int(group.sum()), **shares, "best IoU": best}
        adjoin, scores = scores_by_adjoining(path, truths)
        for name, kind in {"no objects adjoin": ~adjoin, "some objects adjoin": adjoin}.items():
            means = np.nanmean(scores[kind], axis=0).tolist() if kind.any() else [np.nan] * len(METRICS)
            images: Line = dict(zip(METRICS, means, strict=True))
            yield {"labels": path.stem, "objects in": name, "images": int(kind.sum()), **images}


def scores_by_adjoining(
    path: Path, truths: list[Truth]
) -> tuple[Bool[np.ndarray, " image"], Float64[np.ndarray, "image metric"]]:
    """Score every image with two objects or more; tells whether some of its objects adjoin. Ignores missing depth."""
    adjoin, scores = [], []
    for (truth, ignore), (labels, background_slot) in zip(truths, read_labels(path), strict=True):
        arrays = (array.reshape(-1, 1, *array.shape[2:]) for array in (truth, labels, ignore))
        for true, found, out in zip(*arrays, strict=True):
            if len(np.unique(true[(true > 0) & ~out])) > 1:
                adjoin.append(objects_adjoin(true[0]))
                values = score(true, found, background_slot, ignore=out)
                scores.append([values[name] for name in METRICS])
    return np.array(adjoin, dtype=bool), np.array(scores).reshape(-1, len(METRICS))


def objects_adjoin(truth: Integer[np.ndarray, "height width"]) -> bool:
    """Whether pixels of two objects lie side by side or one above the other.

    >>> objects_adjoin(np.array([[1, 0, 2], [1, 0, 0]])), objects_adjoin(np.array([[1, 0, 2], [1, 2, 2]]))
    (False, True)
    """
    pairs = (truth[:, 1:], truth[:, :-1]), (truth[1:], truth[:-1])
    return any(bool(((one != other) & (one > 0) & (other > 0)).any()) for one, other in pairs)
