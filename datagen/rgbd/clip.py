"""A clip as NumPy arrays: input of the benchmark's models, and source of training data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from datagen.geometry import unproject


@dataclass(frozen=True, eq=False)
class Clip:
    """RGB-D frames of one scene from static cameras. Frames of reference are those of `datagen.geometry`."""

    rgb: UInt8[np.ndarray, "frame view height width 3"]
    """sRGB."""
    depth: Float32[np.ndarray, "frame view height width"]
    """Planar z in metres, 0 without a return."""
    valid: Bool[np.ndarray, "frame view height width"]
    """Whether the pixel has a depth."""
    k: Float[np.ndarray, "view 3 3"]
    """Camera matrices in pixels, pixel centres at +0.5."""
    world_from_camera: Float[np.ndarray, "view 4 4"]
    """Poses of the cameras, metres."""
    truth: UInt8[np.ndarray, "frame view height width"] | None = None
    """Object ids, 0 = background; None except for oracles and models that learn from labels."""

    def points(
        self, target_from_camera: Float[np.ndarray, "view 4 4"] | None = None
    ) -> Float[np.ndarray, "frame view height width 3"]:
        """Unproject all pixels, metres, into the world or another target frame; meaningless where `valid` is False."""
        poses = self.world_from_camera if target_from_camera is None else target_from_camera
        cameras = list(zip(self.k, poses, strict=True))
        return np.stack([[unproject(d, *camera) for d, camera in zip(f, cameras, strict=True)] for f in self.depth])

    def select(self, frames: slice | Sequence[int]) -> "Clip":
        """Build a clip of some of the frames."""
        images = {name: getattr(self, name) for name in ("rgb", "depth", "valid", "truth")}
        return replace(self, **{name: None if array is None else array[frames] for name, array in images.items()})
