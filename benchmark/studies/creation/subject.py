"""Which model is measured on which scenes: options that the commands of this folder share."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import torch

from benchmark.ranking.leaderboard import Line, to_csv
from benchmark.studies.claims.command import check_csv
from datagen.errors import UsageError
from datagen.storage.atomic import write_atomically
from datagen.tracks import DataFolder, Source, find_track
from obpose.scenes.model_ref import Origin, load_origin
from obpose.storage.pretrained import shipped_to_create
from obpose.training.devices import keep_memory


@dataclass(frozen=True)
class Subject:
    """A model, by default the one that ships for the track, and scenes."""

    track: str = "moving"
    """Track to look at."""
    data: Path | None = None
    """A dataset folder in the track's place."""
    checkpoint: str = ""
    """Folder of a trained model, or the name of weights that ship; by default those for pictures of the track."""
    split: Literal["train", "val", "test"] = "test"
    """Whose scenes are measured."""
    scenes: int = 100
    """How many of them, from the first on."""
    csv: Path | None = None
    """CSV to write what is printed to, with all digits."""

    @property
    def source(self) -> Source:
        """The dataset."""
        return DataFolder(self.data) if self.data is not None else find_track(self.track)

    def folder(self, others: Sequence[str] = ()) -> Path:
        """Of the dataset, with its split and others made where they are missing."""
        return self.source.prepare((self.split, *others))

    def check(self, **least: int) -> None:
        """Refuse options, by their names, that are less than these, and a CSV of another name.

        Raises:
            UsageError: one is.
        """
        check_csv(self.csv)
        for name, smallest in least.items():
            if (value := getattr(self, name)) < smallest:
                raise UsageError(f"--{name.replace('_', '-')} {value}: expected {smallest} or more.")

    def write_csv(self, origin: Origin, lines: Sequence[Line]) -> None:
        """Write the CSV, if there is to be one."""
        if self.csv is not None:
            told: Line = {"model": origin.name, "data": self.source.name, "split": self.split}
            write_atomically(self.csv, to_csv([{**told, **line} for line in lines]).encode())

    def origin(self) -> Origin:
        """The model, in a process that is set up for it."""
        return chosen_origin(self.checkpoint, self.source.name)


def chosen_origin(checkpoint: str, track: str) -> Origin:
    """The model of a checkpoint, or where it is empty the one for pictures that ships for the track."""
    torch.set_num_threads(1)
    keep_memory()
    return load_origin(checkpoint or shipped_to_create(track))
