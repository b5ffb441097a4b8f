"""Score stored label maps again, without running models."""

from collections.abc import Sequence
from pathlib import Path

from benchmark.execution.runner import SPLIT
from benchmark.execution.scoring import score_labels
from benchmark.ranking.standings import Progress, silent
from benchmark.results.dataset_lookup import labels_path, locate
from benchmark.results.run_folder import RunRow
from datagen.errors import DatagenError
from datagen.storage.reader import Dataset


def rescore(folder: Path, rows: Sequence[RunRow], data: Sequence[Path] = (), *, progress: Progress = silent) -> int:
    """Compute the scene tables of all finished rows anew from their label maps, and give their number.

    Args:
        folder: The run folder.
        rows: Its rows.
        data: Datasets to look into first.
        progress: Shows how many rows are done.

    Raises:
        DatagenError: a row's dataset is not there.
        CorruptFile: its label maps are damaged.
    """
    finished = [row for row in rows if row.status == "ok"]
    # Find all before writing any table, so that an incomplete folder stays unchanged.
    found = [_find(folder, row, data) for row in finished]
    for row, (labels, dataset) in progress(list(zip(finished, found, strict=True)), "scoring rows"):
        score_labels(labels, Dataset(dataset).split(SPLIT), folder, row.key.name)
    return len(finished)


def _find(folder: Path, row: RunRow, data: Sequence[Path]) -> tuple[Path, Path]:
    """Find the label maps and the dataset of a row."""
    labels = labels_path(folder, row)
    if not labels.exists():
        raise DatagenError(f"{labels} is missing; label maps stay on the machine that made them. Run there.")
    dataset = locate(folder, row, data)
    if dataset is None:
        raise DatagenError(f"The dataset of {row.key.name} is not on this machine; name its folder with --data.")
    return labels, dataset
