"""Shared parts of the studies: models and scenes chosen by flags, objects matched with ground truth, tables."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, Integer
from torch import Tensor

from benchmark.metrics.contingency import contingency
from benchmark.metrics.overlap import intersection_over_union
from benchmark.ranking.leaderboard import Cell, Line
from datagen.errors import UsageError
from datagen.storage.reader import Dataset
from datagen.tracks import DataFolder, Source, find_track
from datagen.verify.scene_case import Case, make_case
from obpose.model.obpose import ObPose
from obpose.scenes.clip import read_clip
from obpose.scenes.model_ref import Origin, load_origin
from obpose.storage.pretrained import shipped_to_create
from obpose.training.devices import keep_memory
from obpose.types import Observation, SceneSegmentation

LEAST_IOU = 0.5
"""A slot is matched with an object if their IoU exceeds this; at most one slot can."""
LEAST_FRAMES = 5
"""A slot follows an object if they match in this many frames."""


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
    """Folder of a model, or name of shipped weights; default: obpose-sharp, or else obpose, for the track."""

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
        """Folder of the dataset; missing scenes of the split, and of other splits, are generated."""
        return self.source.prepare((self.split, *others))

    def origin(self) -> Origin:
        """Load the model, and set PyTorch up for inference on one core."""
        torch.set_num_threads(1)
        keep_memory()
        return load_origin(self._model)

    def check(self, **least: int) -> None:
        """Check that options, given by name, have at least these values.

        Raises:
            UsageError: one has not.
        """
        for name, smallest in least.items():
            if (value := getattr(self, name)) < smallest:
                raise UsageError(f"--{name.replace('_', '-')} {value}: expected {smallest} or more.")


@dataclass(frozen=True)
class Followed:
    """An object that one slot follows."""

    row: int
    """Row of the object in the generator's arrays."""
    slot: int
    frames: list[int]
    """Frames in which object and slot match."""


@dataclass(frozen=True, eq=False)
class InferredClip:
    """A clip of one camera with its ground truth, and what a model infers from it."""

    truth: Case
    observation: Observation
    """Batch of one."""
    model: ObPose
    segmentation: SceneSegmentation

    @cached_property
    def followed(self) -> list[Followed]:
        """Objects that one slot matches in enough frames."""
        labels = self.segmentation.labels[0, :, 0].numpy()
        followed = []
        for row, slots in enumerate(matched_slots(self.truth.record["segmentation"][:, 0], labels).T):
            slot = int(np.bincount(slots + 1)[1:].argmax()) if (slots >= 0).any() else 0
            frames = np.flatnonzero(slots == slot).tolist()
            if len(frames) >= LEAST_FRAMES:
                followed.append(Followed(row, slot, frames))
        return followed

    def occupied(self, row: int, frame: int, points: Float[Tensor, "*shape 3"]) -> Bool[Tensor, "*shape"]:
        """Whether world points lie inside an object; exact."""
        pose = self.truth.world_from_object[frame, row]
        local = (points.reshape(-1, 3).double().numpy() - pose[:3, 3]) @ pose[:3, :3]
        return torch.from_numpy(self.truth.shapes[row].signed_distance(local) < 0).view(points.shape[:-1])

    def turned(self, row: int, frames: list[int]) -> Float[np.ndarray, " frame"]:
        """Angles in degrees between an object's orientation in these frames and in the first of them."""
        rotation = self.truth.world_from_object[frames, row, :3, :3]
        traces = np.einsum("fij,ij->f", rotation, rotation[0])
        return np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))


def infer_clips(model: ObPose, folder: Path, split: str, count: int) -> Iterator[InferredClip]:
    """Infer the first clips of a split.

    Raises:
        UsageError: the clips have several views.
    """
    dataset = Dataset(folder)
    if dataset.views > 1:
        raise UsageError(f"{folder} has {dataset.views} views; expected clips of one camera.")
    records = dataset.split(split)
    for index in range(min(count, len(records))):
        observation = read_clip(folder, split, index)
        yield InferredClip(make_case(records[index]), observation, model, model.segment(observation))


def matched_slots(
    truth: Integer[np.ndarray, "frame height width"], labels: Integer[np.ndarray, "frame height width"]
) -> Int[np.ndarray, "frame object"]:
    """Slot that matches each object in each frame, -1 for none; slot k has label k + 1.

    >>> matched_slots(np.array([[[1, 1, 2, 2]]]), np.array([[[0, 3, 3, 3]]]))
    array([[-1,  2]])
    """
    tables, _ = contingency(truth, labels)
    iou = intersection_over_union(tables)[:, 1:]
    iou[..., 0] = LEAST_IOU
    return iou.argmax(axis=2) - 1


def check_suffix(flag: str, path: Path | None, suffix: str) -> None:
    """Check the ending of a file's name.

    Raises:
        UsageError: it differs.
    """
    if path is not None and path.suffix != suffix:
        raise UsageError(f"{flag} {path}: expected a name that ends with {suffix}.")


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
