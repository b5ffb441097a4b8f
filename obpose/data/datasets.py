"""Datasets on disk as PyTorch datasets of clips; labels only on request."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from datagen import schema
from datagen.console.text import counted
from datagen.errors import UsageError, unknown_name
from datagen.storage import reader
from datagen.storage.reader import read_depth
from obpose.data.clips import check_window

_PATHS = "camera/world_from_camera_of_frame"

Window = Literal["first", "random", "all"]


class SceneDataset(Dataset[dict[str, Tensor]]):
    """Split of a dataset folder; each item is a clip, or a window of one.

    An item is a dict of tensors:

    - `rgb`: Float32 "frame view height width 3", sRGB in 0..1
    - `depth`: Float32 "frame view height width", planar z in metres, 0 where there is no return
    - `valid`: Bool "frame view height width", whether the pixel has a depth
    - `k`: Float32 "view 3 3", camera matrices in pixels, pixel centres at +0.5
    - `world_from_camera`: Float32 "view 4 4", poses of the cameras with OpenCV axes, metres; if they move, those of the
      window's first frame
    - each field named in `extra`, under its name, with its axes in `datagen.schema.FIELDS`; depths in metres, other
      integers as int64, floats as float32. Labels are read only by `extra=["segmentation"]`.

    Files are opened on first use in each process, so that any number of loader workers can share the dataset.
    """

    def __init__(
        self,
        folder: str | Path,
        split: str = "train",
        *,
        frames: int | None = None,
        window: Window = "first",
        views: int | Sequence[int] | None = None,
        depth: Literal["observed", "clean"] = "observed",
        extra: Sequence[str] = (),
        seed: int = 0,
    ):
        """Read the description of the dataset, and choose what items hold.

        Args:
            folder: Folder of a dataset made by obpose-datagen.
            split: `train`, `val` or `test`.
            frames: Length of a window; None for whole clips.
            window: `first`: each clip's first frames; `random`: a random start, which depends only on seed, epoch (see
                `set_epoch`) and index; `all`: clips are cut into as many windows as fit, each an item.
            views: Number of views, from the first on, or indices of views; None for all.
            depth: `observed`: depth of the sensor, if the recipe has one; `clean`: the exact depth.
            extra: Names of further fields.
            seed: Seed of the random windows.

        Raises:
            UsageError: the dataset, the split, a view or a field does not exist, windows are longer than clips, or a
                value has the wrong type.
            CorruptFile: the dataset's description is damaged.
        """
        dataset = reader.Dataset(folder)
        self._scenes = dataset.split(split)
        spec = self._scenes.spec
        if spec["resolution"] is None:
            raise UsageError(f"{folder} holds no images; make them with: obpose-datagen render.")
        self._clip_frames: int = spec["recipe"]["frames"]
        self._frames = _window_length(frames, self._clip_frames, folder)
        self._extra: tuple[str, ...] = ()
        self._window = _one_of(window, ("first", "random", "all"), "window")
        self._views = _chosen_views(views, self._scenes.views, folder)
        self._exact = _one_of(depth, ("observed", "clean"), "depth") == "clean"
        if isinstance(extra, str):
            raise UsageError(f"extra={extra!r} is a text; expected a list of names, such as [{extra!r}].")
        if unknown := [name for name in extra if dataset.imported and name not in dataset.fields(split)]:
            raise UsageError(f"{folder} was imported, and {unknown[0]} is unknown in its split {split}.")
        numeric = [name for name in dataset.fields(split) if schema.FIELDS[name].dtype != "S"]
        self._extra = tuple(_one_of(name, numeric, "field") for name in extra)
        self._check_cameras(self._frames)
        self._seed = _not_negative(seed, "seed")
        # In shared memory, so that persistent workers see the number of the next epoch.
        self._epoch = torch.zeros((), dtype=torch.int64).share_memory_()

    def set_epoch(self, epoch: int) -> None:
        """Choose the random windows of an epoch; call it before iterating.

        Raises:
            UsageError: the number is negative.
        """
        self._epoch.fill_(_not_negative(epoch, "epoch"))

    @property
    def recipe(self) -> str:
        """Name of the dataset's recipe."""
        return self._scenes.spec["recipe"]["name"]

    @property
    def settings_hash(self) -> str:
        """SHA-256 of the dataset's settings, except for the number of scenes."""
        return self._scenes.settings_hash

    @property
    def frames_of_clip(self) -> int:
        """Frames of a whole clip."""
        return self._clip_frames

    def __len__(self) -> int:
        return len(self._scenes) * self._windows_per_clip

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        if not 0 <= index < len(self):
            raise IndexError(f"Item {index} of a dataset with {counted(len(self), 'item')}, counted from 0.")
        scene, window = divmod(index, self._windows_per_clip)
        return self.window(scene, self._start(index, window), self._frames)

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        """Read frames of a scene, independently of the dataset's windows (see `obpose.data.clips.ClipSource`).

        Raises:
            IndexError: there is no such scene.
            UsageError: the clip has no such frames.
            CorruptFile: a file is damaged.
        """
        if not 0 <= index < len(self._scenes):
            raise IndexError(f"Scene {index} of a split with {counted(len(self._scenes), 'scene')}, counted from 0.")
        check_window(start, frames, self._clip_frames)
        self._check_cameras(frames)
        chosen = slice(start, start + frames)
        moving = (_PATHS,) if self._scenes.has_moving_cameras else ()
        fields = {"rgb", "camera/K", "camera/world_from_camera", *moving, *self._extra}
        record = self._scenes.read(index, fields, chosen)
        record = {name: self._select_views(name, array) for name, array in record.items()}
        if moving:
            record["camera/world_from_camera"] = record[_PATHS][0]
        depth, valid = read_depth(self._scenes, index, chosen, exact=self._exact)
        return {
            "rgb": torch.from_numpy(record["rgb"]).to(torch.float32).mul_(1 / 255),
            "depth": torch.from_numpy(self._select_views("depth", depth)),
            "valid": torch.from_numpy(self._select_views("depth", valid)),
            "k": _tensor("camera/K", record["camera/K"]),
            "world_from_camera": _tensor("camera/world_from_camera", record["camera/world_from_camera"]),
            **{name: _tensor(name, record[name]) for name in self._extra},
        }

    def _check_cameras(self, frames: int) -> None:
        """Check that one pose fits all frames of a window, or that the caller reads the pose of each frame.

        Raises:
            UsageError: the cameras move, and the caller does not read their poses.
        """
        if frames > 1 and _PATHS not in self._extra:
            reader.require_stationary(self._scenes, f"a window without extra=[{_PATHS!r}]")

    @property
    def _windows_per_clip(self) -> int:
        return self._clip_frames // self._frames if self._window == "all" else 1

    def _start(self, index: int, window: int) -> int:
        if self._window == "random":
            rng = np.random.default_rng([self._seed, int(self._epoch), index])
            return int(rng.integers(self._clip_frames - self._frames + 1))
        return window * self._frames

    def _select_views(self, name: str, array: np.ndarray) -> np.ndarray:
        axes = schema.FIELDS[name].axes
        if self._views is None or "view" not in axes:
            return array
        return np.take(array, self._views, axis=axes.index("view"))


def _tensor(name: str, array: np.ndarray) -> Tensor:
    """Convert depths to metres, other integers to int64, floats to float32."""
    if schema.FIELDS[name].unit == "0.1 mm":
        return torch.from_numpy(schema.decode_depth(array))
    return torch.from_numpy(array.astype(np.int64 if array.dtype.kind in "iu" else np.float32))


def _window_length(frames: int | None, clip_frames: int, folder: str | Path) -> int:
    if frames is None:
        return clip_frames
    if not _is_whole(frames) or not 1 <= frames <= clip_frames:
        raise UsageError(
            f"Windows of {frames} frames: clips of {folder} have {clip_frames}; choose 1 to {clip_frames}."
        )
    return frames


def _chosen_views(views: int | Sequence[int] | None, available: int, folder: str | Path) -> list[int] | None:
    if views is None:
        return None
    chosen = list(range(views)) if isinstance(views, int) else list(views)
    if not chosen or not all(_is_whole(view) and 0 <= view < available for view in chosen):
        raise UsageError(f"Views {views}: clips of {folder} have {available}, counted from 0; choose among them.")
    return chosen


def _is_whole(value: object) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _not_negative(value: int, name: str) -> int:
    if not _is_whole(value) or value < 0:
        raise UsageError(f"{name}={value!r}: expected a whole number of 0 or more.")
    return int(value)


def _one_of(name: str, names: Sequence[str], kind: str) -> str:
    if name not in names:
        raise unknown_name(kind, name, names)
    return name
