"""Scenes as a model sees them, beside what the generator knows of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from datagen.errors import UsageError
from datagen.storage.reader import Dataset
from datagen.verify.scene_case import Case, make_case
from obpose.data.clips import observation_of
from obpose.data.datasets import SceneDataset
from obpose.model.obpose import ObPose
from obpose.types import Observation, SceneSegmentation

LEAST_IOU = 0.5
"""Of an object's pixels and a slot's, from which on the slot is the object's."""
LEAST_FRAMES = 5
"""In which a slot has to be the object's."""
LEAST_PATH, LEAST_TURN = 0.05, 30.0
"""Metres from which on an object moves, degrees from which on it turns."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One clip."""

    observation: Observation
    """As a batch of one."""
    truth: Case

    def occupied(self, row: int, frame: int, points: Float[Tensor, "*shape 3"]) -> Bool[Tensor, "*shape"]:
        """Whether world points lie in an object; exact."""
        pose = self.truth.world_from_object[frame, row]
        local = (points.reshape(-1, 3).double().numpy() - pose[:3, 3]) @ pose[:3, :3]
        inside = self.truth.shapes[row].signed_distance(local) < 0
        return torch.from_numpy(inside).view(points.shape[:-1])

    def center(self, row: int, frame: int) -> Float[Tensor, "3"]:
        """Middle of the object's bounding box along the world's axes: what T_shape estimates."""
        pose = self.truth.world_from_object[frame, row]
        corners = self.truth.shapes[row].vertices @ pose[:3, :3].T + pose[:3, 3]
        return torch.from_numpy((corners.min(axis=0) + corners.max(axis=0)) / 2).float()

    def moves(self, row: int, frames: list[int]) -> bool:
        """Whether the object goes or turns far enough, between any of these frames and the first of them."""
        path = self.truth.world_from_object[frames, row, :3, 3]
        return bool(np.linalg.norm(path - path[0], axis=1).max() > LEAST_PATH) or self.turns(row, frames)

    def turns(self, row: int, frames: list[int]) -> bool:
        """Whether it turns far enough."""
        return bool(self.angles(row, frames).max() > LEAST_TURN)

    def angles(self, row: int, frames: list[int]) -> Float[np.ndarray, " frame"]:
        """Degrees from the orientation in the first of the frames."""
        rotation = self.truth.world_from_object[frames, row, :3, :3]
        traces = np.einsum("fij,ij->f", rotation, rotation[0])
        return np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))


@dataclass(frozen=True)
class Found:
    """An object that a slot follows."""

    row: int
    """Of the object in the generator's arrays."""
    slot: int
    frames: list[int]
    """In which the slot is the object's."""


@dataclass(frozen=True, eq=False)
class Account:
    """What a model makes of a scene."""

    scene: Scene
    model: ObPose
    segmentation: SceneSegmentation

    @cached_property
    def found(self) -> list[Found]:
        """Objects that are the same slot's in enough frames."""
        found = []
        for row, slots in enumerate(self.slots.T):
            slot = np.bincount(slots[slots >= 0]).argmax() if (slots >= 0).any() else -1
            frames = np.flatnonzero((slots == slot) & (slots >= 0)).tolist()
            if len(frames) >= LEAST_FRAMES:
                found.append(Found(row, int(slot), frames))
        return found

    @cached_property
    def slots(self) -> Int[np.ndarray, "frame object"]:
        """The slot of each object in each frame, from 0; -1 where it is nobody's."""
        labels = self.segmentation.labels[0].numpy()
        truth = self.scene.truth.record["segmentation"]
        frames, objects = len(labels), self.scene.truth.count
        slots = np.full((frames, objects), -1)
        for frame, row in np.ndindex(frames, objects):
            object_ = truth[frame] == row + 1
            if not object_.any():
                continue
            shares = [_iou(object_, labels[frame] == slot + 1) for slot in range(self.model.config.model.slots)]
            if max(shares) > LEAST_IOU:
                slots[frame, row] = int(np.argmax(shares))
        return slots


def read_scenes(folder: Path, split: str, count: int) -> Iterator[Scene]:
    """The first scenes of a split.

    Raises:
        UsageError: its scenes have several views.
    """
    source, records = SceneDataset(folder, split), Dataset(folder).split(split)
    if records.views > 1:
        raise UsageError(f"{folder} has {records.views} views; expected clips that one camera sees.")
    for index in range(min(count, len(source))):
        window = source.window(index, 0, source.frames_of_clip)
        yield Scene(observation_of([window]), make_case(records[index]))


def account(model: ObPose, scene: Scene) -> Account:
    """Let a model look at a scene."""
    return Account(scene, model, model.segment(scene.observation))


def _iou(one: np.ndarray, other: np.ndarray) -> float:
    return float((one & other).sum() / max((one | other).sum(), 1))
