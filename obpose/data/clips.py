"""Sources of clips for training, and batches of clips."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from typing import Protocol, TypeVar, runtime_checkable

import torch
from einops import rearrange
from jaxtyping import Int
from torch import Tensor

from datagen.console.text import counted
from datagen.rgbd.clip import Clip
from obpose.errors import UsageError
from obpose.types import Observation

Observed = TypeVar("Observed", bound=Observation)

_CAMERAS = ("k", "world_from_camera")
_ALL = slice(None)


@runtime_checkable
class ClipSource(Protocol):
    """Clips of equal size that are read in windows. `obpose.data.datasets.SceneDataset` of whole clips is one."""

    @property
    def frames_of_clip(self) -> int:
        """Frames of every clip."""
        ...

    def __len__(self) -> int:
        """Number of clips."""
        ...

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        """Read `frames` consecutive frames of a clip: fields of `obpose.types.Observation` without the batch axis.

        A source may add `segmentation` (Int64 "frame view height width", 0 = background). Validation uses it only to
        score segmentations. In training it is passed only to models whose observation type has this field.
        """
        ...


def check_window(start: int, frames: int, clip_frames: int) -> None:
    """Check that a window lies inside a clip.

    Raises:
        UsageError: the window exceeds the clip or is empty.
    """
    if start < 0 or frames < 1 or start + frames > clip_frames:
        raise UsageError(
            f"A window of {counted(frames, 'frame')} from frame {start} on is not inside a clip of "
            f"{counted(clip_frames, 'frame')}; expected 1 or more of its frames, counted from 0."
        )


class ArrayClips:
    """A source over a sequence of clips, read on demand."""

    def __init__(self, clips: Sequence[Clip]):
        self._clips = clips

    @property
    def frames_of_clip(self) -> int:
        """Frames of the first clip; all clips have as many.

        Raises:
            UsageError: there are no clips.
        """
        if not len(self._clips):
            raise UsageError("There are no clips; expected at least one.")
        return len(self._clips[0].depth)

    def __len__(self) -> int:
        return len(self._clips)

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        """Read `frames` consecutive frames of a clip as tensors; colours become 0 to 1.

        Raises:
            UsageError: the clip has no such frames.
        """
        clip, cut = self._clips[index], slice(start, start + frames)
        check_window(start, frames, len(clip.depth))
        return {
            "rgb": torch.from_numpy(clip.rgb[cut]).to(torch.float32).mul_(1 / 255),
            "depth": torch.from_numpy(clip.depth[cut]).to(torch.float32),
            "valid": torch.from_numpy(clip.valid[cut]),
            "k": torch.from_numpy(clip.k).to(torch.float32),
            "world_from_camera": torch.from_numpy(clip.world_from_camera).to(torch.float32),
        }


class LabelledArrayClips(ArrayClips):
    """A source that adds ground-truth labels, for models trained with supervision."""

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        """Read `frames` consecutive frames of a clip, with `segmentation`.

        Raises:
            UsageError: the clip has no labels, or no such frames.
        """
        truth = self._clips[index].truth
        if truth is None:
            raise UsageError(f"Clip {index} has no labels, which this model learns from; give it clips with labels.")
        labels = torch.from_numpy(truth[start : start + frames]).to(torch.int64)
        return {**super().window(index, start, frames), "segmentation": labels}


def stack(windows: Sequence[Mapping[str, Tensor]], kind: type[Observation] = Observation) -> dict[str, Tensor]:
    """Stack windows of equal size into a batch, with only the fields of the observation type `kind`.

    Raises:
        UsageError: a field is missing, such as the labels of a supervised model.
    """
    names = [field.name for field in fields(kind)]
    if missing := [name for name in names if any(name not in window for window in windows)]:
        raise UsageError(f"The clips have no {missing[0]}, which this model learns from; give it clips with labels.")
    return {name: torch.stack([window[name] for window in windows]) for name in names}


def observation_of(windows: Sequence[Mapping[str, Tensor]], kind: type[Observed] = Observation) -> Observed:
    """Stack windows of equal size into an observation of type `kind`."""
    return kind(**stack(windows, kind))


def random_view(observation: Observed, generator: torch.Generator | None) -> Observed:
    """Keep one random view of each clip."""
    clips, device = torch.arange(len(observation.depth)), observation.depth.device
    view = torch.randint(observation.depth.shape[2], clips.shape, generator=generator, device=device)
    return _each(observation, lambda each: each[clips, :, view][:, :, None], lambda each: each[clips, view][:, None])


def separate_views(observation: Observed) -> Observed:
    """Turn every view into a separate clip of one view."""
    return _each(
        observation,
        lambda images: rearrange(images, "batch frame view ... -> (batch view) frame 1 ..."),
        lambda cameras: rearrange(cameras, "batch view ... -> (batch view) 1 ..."),
    )


def select_part(observation: Observed, *, frames: slice | Int[Tensor, " some"] = _ALL, views: slice = _ALL) -> Observed:
    """Select frames and views of an observation."""
    return _each(observation, lambda images: images[:, frames, views], lambda cameras: cameras[:, views])


def _each(observation: Observed, images: Callable[[Tensor], Tensor], cameras: Callable[[Tensor], Tensor]) -> Observed:
    """Apply a function to the images of an observation, and another to its cameras."""
    values = {field.name: getattr(observation, field.name) for field in fields(observation)}
    changed = {name: (cameras if name in _CAMERAS else images)(value) for name, value in values.items()}
    return replace(observation, **changed)
