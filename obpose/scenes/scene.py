"""Scenes as values: codes and poses of objects, the background, the appearance and the cameras."""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

from jaxtyping import Float
from torch import Tensor

from obpose.errors import UsageError
from obpose.scenes.appearance import Appearance

LARGEST_ID = 2**31 - 1
"""Largest name of an object."""
Split = Literal["train", "val", "test"]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with OpenCV axes."""

    k: Float[Tensor, "3 3"]
    """Intrinsics in pixels; pixel centres are at +0.5."""
    world_from_camera: Float[Tensor, "4 4"]
    """Pose in metres."""
    width: int
    height: int

    def resized(self, width: int, height: int) -> "Camera":
        """Give the same view in an image of another size; the aspect ratio may change."""
        scale = self.k.new_tensor([[width / self.width], [height / self.height], [1.0]])
        return Camera(self.k * scale, self.world_from_camera, width, height)


@dataclass(frozen=True)
class ClipName:
    """Identity of the clip that a scene was inferred from."""

    dataset: str
    """SHA-256 of the settings of the dataset (`obpose.data.datasets.SceneDataset.settings_hash`)."""
    split: Split
    index: int

    def __str__(self) -> str:
        return f"{self.split} scene {self.index}"


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects and background of a clip, in the latent space of one model.

    Every object exists in all frames, also while it is out of view.
    """

    ids: tuple[int, ...]
    """Names of the objects; they do not change when others are removed. 0 is the background."""
    what: Float[Tensor, "frame object what"]
    """z_what."""
    center: Float[Tensor, "frame object 3"]
    """Centres of the objects' boxes, world frame, metres."""
    rotation: Float[Tensor, "frame object 3 3"]
    """Rotations, world from object."""
    background: Float[Tensor, "frame background"]
    """z_bg."""
    appearance: Appearance
    """Details of the objects, light and table texture, which the latents leave out."""
    cameras: tuple[Camera, ...]
    """Input cameras; the first is the default for rendering."""
    model: str
    """SHA-256 of the weights that made the latents."""
    checkpoint: str
    """Place of these weights: a folder, or the name of weights that ship with the package."""
    clip: ClipName | None = None
    """Clip that the scene was inferred from, before any edits; None if it was sampled or is unknown."""

    def with_appearance(self, **changes: Any) -> "Scene":
        """Replace fields of the appearance."""
        return replace(self, appearance=replace(self.appearance, **changes))

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.background)

    def place(self, name: int) -> int:
        """Give the index of an object by its name.

        Raises:
            UsageError: there is no such object; the message lists the existing ones.
        """
        if name not in self.ids:
            there = f"Its objects are {', '.join(map(str, self.ids))}." if self.ids else "It has no objects."
            raise UsageError(f"The scene has no object {name}. {there}")
        return self.ids.index(name)

    def look(self, frame: int, place: int) -> bytes:
        """Give a key of the look of an object, which does not depend on its pose."""
        look = self.appearance
        parts = (self.what[frame, place], look.detail[place], look.own_scale[place], look.half_extent[place])
        return b"".join(part.numpy().tobytes() for part in parts)

    def new_id(self) -> int:
        """Give an unused name: the next one, or the least free one if there is no next one."""
        following = max(self.ids, default=0) + 1
        return following if following <= LARGEST_ID else min(set(range(1, len(self.ids) + 2)) - set(self.ids))


def upright(yaw: float, like: Tensor) -> Float[Tensor, "3 3"]:
    """Give the rotation about the world's z axis by an angle in radians."""
    return axis_rotation("z", yaw, like)


def axis_rotation(axis: Literal["x", "y", "z"], angle: float, like: Tensor) -> Float[Tensor, "3 3"]:
    """Give the rotation about an axis by an angle in radians, in the type of `like`."""
    cos, sin = math.cos(angle), math.sin(angle)
    about_z = like.new_tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    shift = "zxy".index(axis)
    return about_z.roll((shift, shift), dims=(0, 1))
