"""Scoring stored label maps again: no model runs."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from benchmark.labels import dataset_of
from benchmark.runner import SPLIT
from benchmark.results import LABELS, RunKey, RunRow
from benchmark.scoring import score_labels
from benchmark.tracks import find_dataset
from datagen.errors import DatagenError
from datagen.storage import Dataset


def rescore(folder: Path, rows: Sequence[RunRow], data: Sequence[Path] = ()) -> int:
    """Compute the scene tables of all finished rows anew from their label maps; returns how many.

    Args:
        folder: The run folder.
        rows: Its rows.
        data: Datasets to look into, besides the tracks' cache and where the label maps say they came from.

    Raises:
        DatagenError: a row's label maps or its dataset are not there.
        CorruptFile: they are damaged.
    """
    finished = [row for row in rows if row.status == "ok"]
    for row in finished:
        labels = labels_path(folder, row)
        dataset = Dataset(_dataset(row.key, labels, data))
        score_labels(labels, dataset.split(SPLIT), folder, row.key.name)
    return len(finished)


def labels_path(folder: Path, row: RunRow) -> Path:
    """Where a row's label maps are: those of seed 0 where seeds make no difference."""
    key = row.key if row.random else dataclasses.replace(row.key, seed=0)
    return folder / LABELS / f"{key.name}.h5"


def _dataset(key: RunKey, labels: Path, data: Sequence[Path]) -> Path:
    candidates = [*data, *([dataset_of(labels)] if labels.exists() else [])]
    if found := find_dataset(key.track, key.track_spec, candidates):
        return found
    raise DatagenError(f"The dataset of {key.name} is not on this machine; name its folder with --data.")
