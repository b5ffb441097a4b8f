"""A scene as a value: what and where its objects are, what its background is, and from where it was seen."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from jaxtyping import Float
from torch import Tensor

from obpose.errors import UsageError
from obpose.scenes.appearance.light import no_light
from obpose.scenes.appearance.table_texture import no_pattern

LARGEST_ID = 2**31 - 1
"""Of an object's name."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with OpenCV axes."""

    k: Float[Tensor, "3 3"]
    """Pixels, pixel centres at +0.5."""
    world_from_camera: Float[Tensor, "4 4"]
    """Metres."""
    width: int
    height: int

    def resized(self, width: int, height: int) -> "Camera":
        """The same view in an image of another size; its sides need not keep their ratio."""
        scale = self.k.new_tensor([[width / self.width], [height / self.height], [1.0]])
        return Camera(self.k * scale, self.world_from_camera, width, height)


@dataclass(frozen=True)
class ClipName:
    """Which clip of which dataset a scene was inferred from."""

    dataset: str
    """SHA-256 of the settings that the dataset was made with (`obpose.data.datasets.SceneDataset.settings_hash`)."""
    split: str
    index: int

    def __str__(self) -> str:
        return f"{self.split} scene {self.index}"


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects and background of a clip, in the latent space of one model.

    An object is in all frames; where it is not in view it is somewhere else.
    """

    ids: tuple[int, ...]
    """Names of the objects; they stay when others are removed, and 0 is the background's."""
    what: Float[Tensor, "frame object what"]
    """z_what."""
    center: Float[Tensor, "frame object 3"]
    """Of the objects' boxes, world frame, metres."""
    rotation: Float[Tensor, "frame object 3 3"]
    """World from object."""
    detail: Float[Tensor, "object edge edge edge 4"]
    """What their latents leave out (`obpose.model.nerf.detail`); 0 where nobody has looked for it."""
    alone: Float[Tensor, "object"]
    """Where positive, there is nothing of the object but its detail, in a cube of so many times the box's edge."""
    background: Float[Tensor, "frame background"]
    """z_bg."""
    cameras: tuple[Camera, ...]
    """That it was seen with; the first renders it where no other is named."""
    model: str
    """SHA-256 of the weights that the latents are of."""
    checkpoint: str
    """Where these weights were: a folder, or the name of weights that ship with this package."""
    clip: ClipName | None = None
    """That it was inferred from, edited since or not; None where it was sampled, or nobody knows."""
    light: Float[Tensor, "4"] = field(default_factory=no_light)
    """What casts shadows on the background (`obpose.scenes.appearance.light`)."""
    pattern: Float[Tensor, "x y 3"] = field(default_factory=no_pattern)
    """Of the table (`obpose.scenes.appearance.table_texture`)."""

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.background)

    def place(self, name: int) -> int:
        """Where the object stands among the others.

        Raises:
            UsageError: there is no such object; says which there are.
        """
        if name not in self.ids:
            there = f"There are {_listed(self.ids)}." if self.ids else "There are none at all."
            raise UsageError(f"The scene has no object {name}. {there}")
        return self.ids.index(name)

    def look(self, frame: int, place: int) -> bytes:
        """What an object looks like, wherever it is: equal for those that look the same."""
        parts = (self.what[frame, place], self.detail[place], self.alone[place])
        return b"".join(part.numpy().tobytes() for part in parts)

    def new_id(self) -> int:
        """A name that no object has: the next one, or, where names have come to an end, the least that is free."""
        following = max(self.ids, default=0) + 1
        return following if following <= LARGEST_ID else min(set(range(1, len(self.ids) + 2)) - set(self.ids))


def _listed(names: Sequence[int]) -> str:
    return ", ".join(map(str, names))


def upright(yaw: float, like: Tensor) -> Float[Tensor, "3 3"]:
    """Rotation about the world's z axis by an angle in radians."""
    return axis_rotation("z", yaw, like)


def axis_rotation(axis: Literal["x", "y", "z"], angle: float, like: Tensor) -> Float[Tensor, "3 3"]:
    """Rotation about an axis by an angle in radians, of the same kind of numbers as `like`."""
    cos, sin = math.cos(angle), math.sin(angle)
    about_z = like.new_tensor([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    shift = "zxy".index(axis)
    return about_z.roll((shift, shift), dims=(0, 1))
