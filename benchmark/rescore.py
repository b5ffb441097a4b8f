"""Scoring stored label maps again: no model runs."""

from collections.abc import Sequence
from pathlib import Path

from benchmark.results import RunRow
from benchmark.runner import SPLIT
from benchmark.scoring import score_labels
from benchmark.whereabouts import labels_path, locate
from datagen.errors import DatagenError
from datagen.storage import Dataset


def rescore(folder: Path, rows: Sequence[RunRow], data: Sequence[Path] = ()) -> int:
    """Compute the scene tables of all finished rows anew from their label maps; returns how many.

    Args:
        folder: The run folder.
        rows: Its rows.
        data: Datasets to look into first.

    Raises:
        DatagenError: a row's dataset is not there.
        CorruptFile: its label maps are missing or damaged.
    """
    finished = [row for row in rows if row.status == "ok"]
    for row in finished:
        labels = labels_path(folder, row)
        if not labels.exists():
            raise DatagenError(f"{labels} is missing; label maps stay on the machine that made them. Run there.")
        dataset = locate(folder, row, data)
        if dataset is None:
            raise DatagenError(f"The dataset of {row.key.name} is not on this machine; name its folder with --data.")
        score_labels(labels, Dataset(dataset).split(SPLIT), folder, row.key.name)
    return len(finished)
