"""A dataset with edits, and an editor that knows the truth."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmark.models.editor_interface import Picture
from benchmark.tasks.editing.truth import EditedScene, read_edits
from datagen.pipeline.generate import generate
from datagen.schema import EDITS, EditKind
from datagen.storage.reader import Dataset, Split
from tests.worlds import generated

SCENES = 2


def make(folder: Path) -> Path:
    """Two test scenes of three frames with all edits."""
    generate(folder, generated.recipe(), splits={"test": SCENES}, resolution=generated.RESOLUTION, edits=EDITS)
    return folder


def scenes_of(folder: Path) -> Split:
    return Dataset(folder).split("test")


def truth_of(folder: Path, index: int = 0) -> EditedScene:
    return read_edits(scenes_of(folder), index, EDITS)


class Oracle:
    """An editable scene that shows what is true; its labels are the ids, and 10 more."""

    def __init__(self, truth: EditedScene, *, blind: bool = False):
        self._truth = truth
        self.labels = np.where((truth.labels > 0) & (not blind), truth.labels.astype(int) + 10, 0)
        self.asked: list[tuple[EditKind, int]] = []

    def render(self, frames: Sequence[int]) -> Picture:
        assert tuple(frames) == self._truth.frames
        return _named(self._truth.pairs[0].before)

    def edited(self, kind: EditKind, label: int, transform: np.ndarray, frames: Sequence[int]) -> Picture:
        self.asked.append((kind, label))
        pair = next(pair for pair in self._truth.pairs if pair.kind == kind)
        np.testing.assert_array_equal(transform, pair.transform)
        return _named(pair.after)


def _named(picture: Picture) -> Picture:
    return replace(picture, labels=np.where(picture.labels > 0, picture.labels.astype(int) + 10, 0))
