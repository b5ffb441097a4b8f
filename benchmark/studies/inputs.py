"""Shared parts of the studies: models and scenes chosen by flags, and tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from benchmark.ranking.leaderboard import Cell, Line
from datagen.errors import UsageError
from datagen.tracks import DataFolder, Source, find_track
from obpose.scenes.model_ref import Origin, load_origin
from obpose.storage.pretrained import shipped_to_create
from obpose.training.devices import keep_memory


@dataclass(frozen=True, kw_only=True)
class TableFlags:
    """Options of a study that returns a table."""

    csv: Path | None = None
    """CSV file for the table, with all digits."""

    @property
    def columns(self) -> Line:
        """Columns that are equal in all lines; only the CSV has them."""
        return {}


@dataclass(frozen=True, kw_only=True)
class ModelFlags:
    """Model and scenes to measure."""

    track: str = "moving"
    """Name of a track."""
    data: Path | None = None
    """Dataset folder to use instead of the track."""
    split: Literal["train", "val", "test"] = "test"
    """Split of the scenes."""
    scenes: int = 100
    """Number of scenes, from the first on."""
    checkpoint: str = ""
    """Folder of a model, or name of shipped weights; default: obpose-contact, or else obpose, for the track."""

    @property
    def source(self) -> Source:
        """The dataset."""
        return DataFolder(self.data) if self.data is not None else find_track(self.track)

    @property
    def columns(self) -> Line:
        """Names of model, data and split, for the CSV."""
        return {"model": self._model, "data": self.source.name, "split": self.split}

    @property
    def _model(self) -> str:
        return self.checkpoint or shipped_to_create(self.source.name)

    def folder(self, *others: str) -> Path:
        """Folder of the dataset; missing scenes of the split, and of other splits, are generated.

        Raises:
            UsageError: one of these splits has no scenes.
        """
        splits = (self.split, *others)
        folder = self.source.prepare(splits)
        if empty := [name for name in splits if not self.source.size(name)]:
            raise UsageError(f"{folder} has no scenes in split {empty[0]}; expected at least one. Generate some.")
        return folder

    def origin(self) -> Origin:
        """Load the model, and set PyTorch up for inference on one core."""
        torch.set_num_threads(1)
        keep_memory()
        return load_origin(self._model)


def markdown(lines: Sequence[Line]) -> str:
    """Format lines as a table with four significant digits.

    >>> print(markdown([{"what": "a", "value": 1 / 3}, {"what": "b", "number": 2}]))
    | what | value | number |
    |---|---|---|
    | a | 0.3333 |  |
    | b |  | 2 |
    """
    names = list(dict.fromkeys(name for line in lines for name in line))
    rows = [[_cell(line.get(name, "")) for name in names] for line in lines]
    return "\n".join(f"|{'|'.join(row)}|" for row in [[f" {name} " for name in names], ["---"] * len(names), *rows])


def _cell(value: Cell) -> str:
    return f" {value:.4g} " if isinstance(value, float) else f" {value} "
