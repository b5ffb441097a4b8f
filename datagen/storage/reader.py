"""Read datasets with NumPy, h5py and deflate alone.

dataset = Dataset("data/moving-128x128-seed0")
scenes = dataset.split("train")
record = scenes[0]                                            # all arrays of a scene
record = scenes.read(0, ["rgb", "depth"], frames=slice(2, 6))  # some fields, some frames
"""

import operator
import os
from collections import Counter, OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, SupportsIndex, overload

import numpy as np

from datagen.errors import DatagenError, UsageError
from datagen.schema import SPLITS, EditKind, SceneRecord, Signal, decode_depth
from datagen.storage.shard import Checked, PackedScene, Shard, scenes_present
from datagen.storage.spec import (
    Spec,
    edits_of,
    fields_of,
    groups_of,
    has_moving_cameras,
    is_imported,
    read_spec,
    settings_hash,
    shard_name,
    shard_ranges,
    signals_of,
    views_of,
)


class Dataset:
    """A folder of scenes; files are opened when they are needed, so that it can be sent to worker processes.

    Raises:
        UsageError: the folder holds no dataset of this format.
        CorruptFile: its `dataset.json` is damaged.
    """

    def __init__(self, folder: str | Path):
        self.folder = Path(folder)
        self.spec: Spec = read_spec(self.folder)

    @property
    def splits(self) -> dict[str, int]:
        """Number of scenes of each split."""
        return {name: self.spec["splits"][name] for name in SPLITS}

    @property
    def edits(self) -> tuple[EditKind, ...]:
        """Counterfactual edits that its scenes have."""
        return edits_of(self.spec)

    @property
    def signals(self) -> tuple[Signal, ...]:
        """Optional signals that its scenes have."""
        return signals_of(self.spec)

    @property
    def views(self) -> int:
        """Number of cameras."""
        return views_of(self.spec)

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups of fields that its scenes have; see `schema.Field.group`."""
        return groups_of(self.spec)

    @property
    def imported(self) -> bool:
        """Whether the scenes come from another project, so that only some fields are known."""
        return is_imported(self.spec)

    def fields(self, split: str) -> tuple[str, ...]:
        """Names of the fields that the scenes of a split have."""
        return fields_of(self.spec, split)

    def split(self, name: str) -> "Split":
        """The scenes of one split.

        Raises:
            UsageError: there is no such split, or shards beyond its scenes belong elsewhere.
            CorruptFile: such a shard is damaged.
        """
        if name not in self.splits:
            raise UsageError(f"Unknown split {name!r}; expected one of {', '.join(SPLITS)}.")
        scenes = Split(self.folder, self.spec, name)
        scenes_present(self.folder, self.spec, name, first=len(scenes.shards))
        return scenes

    def check_complete(self) -> None:
        """Check that every scene exists.

        Raises:
            DatagenError: scenes are missing; says how many, and where.
            CorruptFile: a file cannot be read.
        """
        missing = {name: self.split(name).missing() for name in SPLITS}
        if any(missing.values()):
            counts = ", ".join(
                f"{len(numbers)} of {self.splits[name]} {name}" for name, numbers in missing.items() if numbers
            )
            raise DatagenError(
                f"{self.folder} is incomplete: {counts} scenes are missing. "
                "Run the command that began it again to complete it."
            )


def require_stationary(scenes: "Split", reader: str) -> None:
    """Check that the cameras of some scenes do not move, for a `reader` that takes one pose for all frames of a clip.

    Raises:
        UsageError: they do.
    """
    if scenes.has_moving_cameras:
        raise UsageError(
            f"The cameras of {scenes.folder} move, and {reader} takes one pose for all frames of a clip. Render the "
            f"scenes with stationary cameras (obpose-datagen render --from {scenes.folder} --rig.motion still, or "
            "--cameras FILE), or use windows of one frame."
        )


class Split(Sequence[SceneRecord]):
    """The scenes of one split, in order; at most `most_open` files are open at a time."""

    def __init__(self, folder: Path, spec: Spec, name: str, *, most_open: int = 64):
        self.folder, self.spec, self.name, self._most_open = folder, spec, name, most_open
        self._per_shard: int = spec["scenes_per_shard"]
        self.settings_hash = settings_hash(spec)
        """SHA-256 of the settings; equal hashes mean equal scenes at equal indices, whatever the number of scenes."""
        self._shards: OrderedDict[int, Shard] = OrderedDict()
        self._checked: dict[int, Checked] = {}
        self._process = os.getpid()

    def __len__(self) -> int:
        return self.spec["splits"][self.name]

    @property
    def views(self) -> int:
        """Number of cameras."""
        return views_of(self.spec)

    @property
    def has_moving_cameras(self) -> bool:
        """Whether cameras have a pose for each frame, `camera/world_from_camera_of_frame`."""
        return has_moving_cameras(self.spec)

    @overload
    def __getitem__(self, index: SupportsIndex) -> SceneRecord: ...
    @overload
    def __getitem__(self, index: slice) -> list[SceneRecord]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        shard, row = self._locate(index)
        return {name: shard.read(row, name) for name in shard.fields}

    def read(self, index: SupportsIndex, fields: Iterable[str], frames: slice | None = None) -> SceneRecord:
        """Read some fields of one scene; `frames` slices the fields that have a frame axis.

        Raises:
            IndexError: there is no such scene.
            UsageError: the dataset has no such field.
            DatagenError: the scene has not been made yet.
            CorruptFile: its file is damaged.
        """
        shard, row = self._locate(index)
        return {name: shard.read(row, name, frames) for name in fields}

    def in_order(self, fields: Iterable[str]) -> Iterator[SceneRecord]:
        """Read some small fields of all scenes, a shard at a time; raises as `read`."""
        for number in range(len(self.shards)):
            shard = self._shard(number)
            columns = {name: shard.column(name) for name in fields}
            for row in range(len(shard)):
                yield {name: column[row] for name, column in columns.items()}

    @property
    def labels_shape(self) -> tuple[int, int, int, int, int]:
        """Shape of the label maps of a split with images: scenes, frames, views, height, width."""
        width, height = self.spec["resolution"]
        return len(self), self.spec["recipe"]["frames"], self.views, height, width

    def hash(self, index: SupportsIndex) -> str:
        """The stored SHA-256 of one scene."""
        shard, row = self._locate(index)
        return shard.hashes()[row]

    def has(self, *fields: str) -> bool:
        """Whether the scenes have all of these fields."""
        return {*fields} <= {*fields_of(self.spec, self.name)}

    def rejections(self, index: SupportsIndex) -> Counter[str]:
        """Number of rejected samples of one scene by reason."""
        shard, row = self._locate(index)
        return shard.rejections(row)

    def fields(self, index: SupportsIndex = 0) -> list[str]:
        """Names of the arrays of one scene that its hash covers."""
        return self._locate(index)[0].fields

    def packed(self, index: SupportsIndex) -> PackedScene:
        """One scene in its stored, compressed form."""
        shard, row = self._locate(index)
        return shard.packed(row)

    @property
    def shards(self) -> list[range]:
        """Indices of the scenes of each shard."""
        return shard_ranges(len(self), self._per_shard)

    def missing(self) -> list[int]:
        """Indices of the scenes that have not been made yet."""
        missing: list[int] = []
        for number, indices in enumerate(self.shards):
            there = len(self._shard(number)) if self.path(number).exists() else 0
            missing.extend(indices[there:])
        return missing

    def path(self, number: int) -> Path:
        """Path of shard `number`."""
        return self.folder / shard_name(self.name, number)

    def close(self) -> None:
        """Close all files; they are opened again when needed."""
        for number in list(self._shards):
            self._close_shard(number)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_shards": OrderedDict(), "_process": -1}

    def _locate(self, index: SupportsIndex) -> tuple[Shard, int]:
        number = operator.index(index)
        if not 0 <= number < len(self):
            raise IndexError(f"Scene {number} of split {self.name}, which has {len(self)} scenes counted from 0.")
        shard, row = self._shard(number // self._per_shard), number % self._per_shard
        if row >= len(shard):
            raise DatagenError(
                f"Scene {number} of split {self.name} is not in {shard.path} yet: the dataset is incomplete. "
                "Run the command that began it again to complete it."
            )
        return shard, row

    def _shard(self, number: int) -> Shard:
        if self._process != os.getpid():
            # HDF5 handles that came along with a fork are dropped, not closed: they belong to the parent.
            self._shards, self._process = OrderedDict(), os.getpid()
        if number not in self._shards:
            if next(reversed(self._shards), None) == number - 1:
                # A pass in order is done with the shard before; HDF5 holds half a MiB for each open file.
                self._close_shard(number - 1)
            self._shards[number] = Shard(
                self.folder,
                self.spec,
                self.name,
                number,
                settings=self.settings_hash,
                checked=self._checked.get(number),
            )
            if len(self._shards) > self._most_open:
                self._close_shard(next(iter(self._shards)))
        self._shards.move_to_end(number)
        return self._shards[number]

    def _close_shard(self, number: int) -> None:
        shard = self._shards.pop(number)
        self._checked[number] = shard.checked
        shard.close()


def read_camera_poses(scenes: Split, index: SupportsIndex, frames: slice | None = None) -> np.ndarray:
    """Read world_from_camera of every image, float64 [frame view 4 4]; poses of static cameras are repeated."""
    if scenes.has_moving_cameras:
        moving = "camera/world_from_camera_of_frame"
        return scenes.read(index, [moving], frames)[moving]
    static = scenes.read(index, ["camera/world_from_camera"])["camera/world_from_camera"]
    count = len(range(scenes.spec["recipe"]["frames"])[frames or slice(None)])
    return np.broadcast_to(static, (count, *static.shape))


def read_depth(
    scenes: Split, index: SupportsIndex, frames: slice | None = None, *, exact: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Read the depth of one scene as observed: the sensor's if the recipe has one, otherwise, or if `exact`, the exact.

    Returns:
        Planar z in metres, float32 [frame view height width], 0 without a return; and whether a pixel has a depth.
    """
    if exact or not scenes.spec["recipe"]["sensor"]["enabled"]:
        stored = scenes.read(index, ["depth"], frames)["depth"]
        return decode_depth(stored), stored > 0
    record = scenes.read(index, ["sensor_depth", "sensor_valid"], frames)
    return decode_depth(record["sensor_depth"]), record["sensor_valid"] > 0
