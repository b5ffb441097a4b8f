"""A split of a dataset as models and metrics get it: clips without labels, and the labels apart from them."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Generic, TypeVar, overload

import numpy as np
from jaxtyping import Integer, UInt8

from benchmark.metrics.poses import TruePoses, visible_centers
from benchmark.models.interface import Clip
from datagen.errors import UsageError
from datagen.geometry import rotation_from_quaternion
from datagen.storage.reader import Split, read_depth, require_stationary

Item = TypeVar("Item")


class _Lazy(Sequence[Item], Generic[Item]):
    """Sequence whose items are read on each access."""

    def __init__(self, length: int, read: Callable[[int], Item]):
        self._length, self._read = length, read

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> list[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | list[Item]:
        if isinstance(index, slice):
            return [self._read(i) for i in range(*index.indices(self._length))]
        return self._read(index)


class ClipSequence(_Lazy[Clip]):
    """The clips of one split, read on access, with the depth of the recipe's sensor if it has one.

    With `uses_labels` the clips carry the ground truth, for oracles and supervised models only.

    Raises:
        UsageError: the dataset holds no images, or its cameras move.
    """

    def __init__(self, scenes: Split, *, uses_labels: bool = False):
        if scenes.spec["resolution"] is None:
            raise UsageError(f"{scenes.folder} holds no images; make them with: obpose-datagen render.")
        require_stationary(scenes, "the benchmark")
        super().__init__(len(scenes), partial(read_clip, scenes, uses_labels=uses_labels))


class TruthSequence(_Lazy[UInt8[np.ndarray, "frame view height width"]]):
    """Object ids of the scenes of one split, 0 = background, read on access."""

    def __init__(self, scenes: Split):
        super().__init__(len(scenes), partial(read_truth, scenes))


def read_clip(scenes: Split, index: int, *, uses_labels: bool = False) -> Clip:
    """Read the clip of one scene, with its ground truth if the model uses labels."""
    record = scenes.read(index, ["rgb", "camera/K", "camera/world_from_camera"])
    depth, valid = read_depth(scenes, index)
    return Clip(
        rgb=record["rgb"],
        depth=depth,
        valid=valid,
        k=record["camera/K"],
        world_from_camera=record["camera/world_from_camera"],
        truth=read_truth(scenes, index) if uses_labels else None,
    )


def read_truth(scenes: Split, index: int) -> UInt8[np.ndarray, "frame view height width"]:
    """Object ids of one scene, 0 = background."""
    return scenes.read(index, ["segmentation"])["segmentation"]


_FIELDS = (
    "objects/count",
    "objects/symmetry",
    "objects/minimum_box_center",
    "objects/minimum_box_rotation",
    "objects/minimum_box_size",
    "poses/position",
    "poses/quaternion_wxyz",
)


def has_true_poses(scenes: Split) -> bool:
    """Whether the true poses of a split are known; those of imported scenes are not."""
    return scenes.has(*_FIELDS)


def read_true_poses(
    scenes: Split, index: int, clip: Clip, truth: Integer[np.ndarray, "frame view height width"]
) -> TruePoses:
    """Read the true poses of one scene, whose object ids are `truth`."""
    record = scenes.read(index, _FIELDS)
    count = int(record["objects/count"])
    rotation = rotation_from_quaternion(record["poses/quaternion_wxyz"][:, :count].astype(np.float64))
    middle = record["objects/minimum_box_center"][:count].astype(np.float64)
    position = record["poses/position"][:, :count].astype(np.float64)
    return TruePoses(
        rotation=rotation,
        symmetry=tuple(bytes(name).decode() for name in record["objects/symmetry"][:count]),
        box_center=position + np.einsum("foij,oj->foi", rotation, middle),
        box_rotation=record["objects/minimum_box_rotation"][:count].astype(np.float64),
        box_size=record["objects/minimum_box_size"][:count].astype(np.float64),
        visible_center=visible_centers(clip.points(), clip.valid, truth, count),
    )
