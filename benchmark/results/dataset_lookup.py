"""Where the label maps and the dataset of a finished row are on this machine."""

import dataclasses
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from benchmark.results.labels import dataset_of
from benchmark.results.run_folder import LABELS, RunRow
from datagen.errors import DatagenError
from datagen.tracks import find_dataset


def labels_path(folder: Path, row: RunRow) -> Path:
    """Where a row's label maps are, if they were kept: those of seed 0 where seeds make no difference."""
    key = row.key if row.random else dataclasses.replace(row.key, seed=0)
    return folder / LABELS / f"{key.name}.h5"


def locate(folder: Path, row: RunRow, data: Iterable[Path] = ()) -> Path | None:
    """The dataset that a row was scored on; None if it is not at hand.

    Looked for in the folders `data`, where the label maps say they came from, and among the tracks that were made.
    """
    candidates = list(data)
    with suppress(DatagenError):
        candidates.append(dataset_of(labels_path(folder, row)))
    return find_dataset(row.key.track, row.key.track_spec, candidates)
