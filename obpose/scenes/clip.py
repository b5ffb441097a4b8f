"""Access to clips of datasets by split and index."""

from pathlib import Path

from obpose.data.clips import observation_of
from obpose.data.datasets import SceneDataset
from obpose.errors import UsageError
from obpose.scenes.scene import ClipName, Split
from obpose.types import Observation


def read_clip(data: Path, split: str, index: int, frame: int | None = None) -> Observation:
    """Read a clip of a dataset, or one frame of it, as a batch of one.

    Raises:
        UsageError: there is no such dataset, split or scene, as `obpose.data.datasets.SceneDataset`.
        CorruptFile: a file is damaged.
    """
    scenes = SceneDataset(data, split, frames=None if frame is None else 1)
    if not len(scenes):
        raise UsageError(f"The split {split} of {data} has no scenes; give another --split.")
    index = one_of("--scene", index, len(scenes))
    return observation_of([scenes[index] if frame is None else scenes.window(index, frame, 1)])


def name_clip(data: Path, split: Split, index: int) -> ClipName:
    """Give the identity of a clip, which scenes store.

    Raises:
        UsageError: there is no such dataset or split.
    """
    return ClipName(SceneDataset(data, split).settings_hash, split, index)


def one_of(flag: str, value: int, count: int) -> int:
    """Check an index of something, counted from 0.

    Raises:
        UsageError: the index is out of range.
    """
    if not 0 <= value < count:
        raise UsageError(f"{flag} {value}: expected {'0' if count == 1 else f'0 to {count - 1}'}.")
    return value
