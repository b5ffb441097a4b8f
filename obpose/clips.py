"""Where training gets its clips from."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from einops import rearrange
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from obpose.types import Observation

FIELDS = tuple(field.name for field in fields(Observation))
"""What a model sees."""


@runtime_checkable
class ClipSource(Protocol):
    """Clips of equal size, of which windows can be read. `obpose.data.SceneDataset` of whole clips is one."""

    @property
    def frames_of_clip(self) -> int:
        """Frames of every clip."""
        ...

    def __len__(self) -> int:
        """How many clips there are."""
        ...

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        """Some frames of a clip: the fields of `obpose.types.Observation` without the batch axis.

        A source for validation may add `segmentation` (Int64 "frame view height width", 0 = background), which is used
        to score segmentations and for nothing else.
        """
        ...


@runtime_checkable
class ArrayClip(Protocol):
    """A clip as arrays, such as `benchmark.interface.Clip`."""

    @property
    def rgb(self) -> UInt8[np.ndarray, "frame view height width 3"]:
        """In sRGB."""
        ...

    @property
    def depth(self) -> Float[np.ndarray, "frame view height width"]:
        """Planar z in metres, 0 where there is no return."""
        ...

    @property
    def valid(self) -> Bool[np.ndarray, "frame view height width"]:
        """Whether the pixel has a depth."""
        ...

    @property
    def k(self) -> Float[np.ndarray, "view 3 3"]:
        """Camera matrices in pixels."""
        ...

    @property
    def world_from_camera(self) -> Float[np.ndarray, "view 4 4"]:
        """Poses of the cameras, metres."""
        ...


class ArrayClips:
    """A sequence of clips as arrays, read when they are needed."""

    def __init__(self, clips: Sequence[ArrayClip]):
        self._clips = clips

    @property
    def frames_of_clip(self) -> int:
        """Frames of the first clip, and so of all."""
        return len(self._clips[0].depth)

    def __len__(self) -> int:
        return len(self._clips)

    def window(self, index: int, start: int, frames: int) -> dict[str, Tensor]:
        """Some frames of a clip."""
        clip, cut = self._clips[index], slice(start, start + frames)
        return {
            "rgb": torch.from_numpy(clip.rgb[cut]).to(torch.float32).mul_(1 / 255),
            "depth": torch.from_numpy(clip.depth[cut]).to(torch.float32),
            "valid": torch.from_numpy(clip.valid[cut]),
            "k": torch.from_numpy(clip.k).to(torch.float32),
            "world_from_camera": torch.from_numpy(clip.world_from_camera).to(torch.float32),
        }


def stack(windows: Sequence[Mapping[str, Tensor]]) -> dict[str, Tensor]:
    """Windows of equal size as one batch; what a model must not see is left behind."""
    return {name: torch.stack([window[name] for window in windows]) for name in FIELDS}


def observation_of(windows: Sequence[Mapping[str, Tensor]]) -> Observation:
    """Windows of equal size as a model sees them."""
    return Observation(**stack(windows))


def views_apart(observation: Observation) -> Observation:
    """Every view as a scene of its own."""
    images, cameras = "batch frame view ... -> (batch view) frame 1 ...", "batch view ... -> (batch view) 1 ..."
    patterns = {"rgb": images, "depth": images, "valid": images, "k": cameras, "world_from_camera": cameras}
    return Observation(**{name: rearrange(getattr(observation, name), how) for name, how in patterns.items()})
