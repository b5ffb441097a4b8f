"""A split of a dataset as models and metrics get it: clips without labels, and the labels apart from them."""

from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from jaxtyping import UInt8

from benchmark.models.interface import Clip
from datagen import schema
from datagen.errors import UsageError
from datagen.storage import reader


class ClipSequence(Sequence[Clip]):
    """The clips of one split, read when they are asked for. Where the recipe has a depth sensor, its depth is seen.

    With `uses_labels` the clips carry the truth: for oracles and supervised models only.

    Raises:
        UsageError: the dataset holds no images.
    """

    def __init__(self, scenes: reader.Split, *, uses_labels: bool = False):
        if scenes.spec["resolution"] is None:
            raise UsageError(f"{scenes.folder} holds no images; make them with: obpose-datagen render.")
        self._scenes = scenes
        self._uses_labels = uses_labels
        self._sensor: bool = scenes.spec["recipe"]["sensor"]["enabled"]

    def __len__(self) -> int:
        return len(self._scenes)

    @overload
    def __getitem__(self, index: int) -> Clip: ...
    @overload
    def __getitem__(self, index: slice) -> list[Clip]: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        depth = "sensor_depth" if self._sensor else "depth"
        fields = ["rgb", depth, "camera/K", "camera/world_from_camera"]
        fields += ["sensor_valid"] if self._sensor else []
        fields += ["segmentation"] if self._uses_labels else []
        record = self._scenes.read(index, fields)
        return Clip(
            rgb=record["rgb"],
            depth=schema.decode_depth(record[depth]),
            valid=record["sensor_valid"] > 0 if self._sensor else record[depth] > 0,
            k=record["camera/K"],
            world_from_camera=record["camera/world_from_camera"],
            truth=record["segmentation"] if self._uses_labels else None,
        )


class TruthSequence(Sequence[UInt8[np.ndarray, "frame view height width"]]):
    """Object ids of the scenes of one split, 0 = background, read when they are asked for."""

    def __init__(self, scenes: reader.Split):
        self._scenes = scenes

    def __len__(self) -> int:
        return len(self._scenes)

    @overload
    def __getitem__(self, index: int) -> np.ndarray: ...
    @overload
    def __getitem__(self, index: slice) -> list[np.ndarray]: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        return read_truth(self._scenes, index)


def read_truth(scenes: reader.Split, index: int) -> UInt8[np.ndarray, "frame view height width"]:
    """Object ids of one scene, 0 = background."""
    return scenes.read(index, ["segmentation"])["segmentation"]
