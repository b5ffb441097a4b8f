"""Scenes as exporters read them: arrays in common units, read on demand; fields that a dataset lacks are absent.

Optional fields of the dataset format are named here only, so that exporters do not depend on their storage.
"""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Float32, UInt8, UInt16

from datagen.schema import SceneRecord
from datagen.shapes.shape import MeshSource
from datagen.storage.reader import Split, read_depth

UNKNOWN_CATEGORY = "object"
"""Category of objects in datasets that name none."""

Direction = Literal["forward", "backward"]


class ExportScene:
    """One scene of a dataset; arrays are read when they are first used and kept as long as the scene."""

    def __init__(self, scenes: Split, index: int, meshes: MeshSource | None = None):
        self.split, self.index, self.meshes = scenes.name, index, meshes
        self._scenes, self._fields = scenes, frozenset(scenes.fields(index))
        self._arrays: SceneRecord = {}

    @property
    def name(self) -> str:
        """Index of the scene in its split as a name of fixed length, so that sorting keeps the order."""
        return f"{self.index:06d}"

    @property
    def dataset(self) -> Path:
        """Folder of the dataset."""
        return self._scenes.folder

    @property
    def place(self) -> str:
        """Place of the scene, for messages."""
        return f"{self.dataset}, {self.split} scene {self.index}"

    def render_command(self, options: str) -> str:
        """Advice to render the scenes with other options, or to choose another format if they cannot be rendered."""
        if self.has("scene/description"):
            return f"render the scenes for it: obpose-datagen render --from {self.dataset} {options}"
        return "choose another --format"

    @property
    def label_renderer(self) -> str:
        """Name of the renderer that made the labels."""
        renderer = self._scenes.spec["renderer"]
        return "pyrender" if renderer and renderer["name"] == "pyrender" else "raster"

    def has(self, *fields: str) -> bool:
        """Whether the dataset has all of these fields."""
        return self._fields.issuperset(fields)

    def read(self, field: str) -> np.ndarray:
        """Read one field as stored."""
        if field not in self._arrays:
            self._arrays.update(self._scenes.read(self.index, [field]))
        return self._arrays[field]

    def record(self) -> SceneRecord:
        """Read all fields that do not depend on pixels."""
        return {name: self.read(name) for name in sorted(self._fields) if name.startswith(_SIMULATED)}

    @cached_property
    def rgb(self) -> UInt8[np.ndarray, "frame view height width 3"]:
        """Colour, sRGB 0-255."""
        return self.read("rgb")

    @cached_property
    def segmentation(self) -> UInt8[np.ndarray, "frame view height width"]:
        """Object ids, 0 for the background."""
        return self.read("segmentation")

    @cached_property
    def depth(self) -> Float32[np.ndarray, "frame view height width"]:
        """Planar depth in metres as observed, that of the sensor if the dataset has one; 0 without a return."""
        return read_depth(self._scenes, self.index)[0]

    @cached_property
    def k(self) -> Float[np.ndarray, "frame view 3 3"]:
        """Camera matrices in pixels, pixel centres at +0.5."""
        return np.broadcast_to(self.read("camera/K"), (self.frames, self.views, 3, 3))

    @cached_property
    def world_from_camera(self) -> Float[np.ndarray, "frame view 4 4"]:
        """Camera poses, OpenCV axes, metres."""
        moving = "camera/world_from_camera_of_frame"
        poses = self.read(moving if self.has(moving) else "camera/world_from_camera")
        return np.broadcast_to(poses, (self.frames, *poses.shape[-3:]))

    @cached_property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.rgb)

    @property
    def views(self) -> int:
        """Number of cameras."""
        return self._scenes.views

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self.rgb.shape[3], self.rgb.shape[2]

    @property
    def fps(self) -> float:
        """Frames per second."""
        return float(self._scenes.spec["recipe"]["fps"])

    @cached_property
    def objects(self) -> int:
        """Number of objects; the greatest id where the dataset does not say."""
        if self.has("objects/count"):
            return int(self.read("objects/count"))
        return int(np.max(self.segmentation, initial=0))

    def per_object(self, field: str, axis: int = 0) -> np.ndarray:
        """Read a field of objects without its padding; `axis` is its object axis."""
        return np.take(self.read(field), range(self.objects), axis=axis)

    def texts(self, field: str) -> list[str]:
        """Read a text field of the objects."""
        return [bytes(text).decode("ascii") for text in self.per_object(field)]

    @cached_property
    def categories(self) -> list[str]:
        """Category of each object."""
        if self.has("objects/category"):
            return [name or UNKNOWN_CATEGORY for name in self.texts("objects/category")]
        return [UNKNOWN_CATEGORY] * self.objects

    def has_flow(self, direction: Direction) -> bool:
        """Whether the dataset has optical flow of this direction."""
        return self.has(f"flow/{direction}")

    def flow(self, direction: Direction, view: int) -> Float32[np.ndarray, "frame height width 2"]:
        """Optical flow (x, y) of one view in pixels."""
        return self.read(f"flow/{direction}")[:, view].astype(np.float32)

    @property
    def has_normals(self) -> bool:
        """Whether the dataset has surface normals."""
        return self.has("normals")

    def normals(self, view: int) -> Float[np.ndarray, "frame height width 3"]:
        """Unit surface normals of one view in world axes; zeros without a surface."""
        world_from_camera = self.world_from_camera[:, view, :3, :3]
        return np.einsum("fij,fhwj->fhwi", world_from_camera, self.read("normals")[:, view] / 32767)

    @property
    def has_object_coordinates(self) -> bool:
        """Whether the dataset has object coordinates."""
        return self.has("object_coordinates")

    def object_coordinates(self, view: int) -> UInt16[np.ndarray, "frame height width 3"]:
        """Places in the objects' minimum-volume boxes, 0 to 65535 along each axis."""
        return self.read("object_coordinates")[:, view]


_SIMULATED = ("objects/", "poses/", "contacts/", "lights/", "scene/", "camera/")


def scenes_of(scenes: Split, meshes: MeshSource | None = None) -> Iterator[ExportScene]:
    """Iterate over the scenes of a split; memory holds one scene, and the file that it is in, at a time.

    `meshes` holds the geometry of a user's meshes, which only some formats need.
    """
    for indices in scenes.shards:
        for index in indices:
            yield ExportScene(scenes, index, meshes)
        scenes.close()


def view_name(scene: ExportScene, view: int) -> str:
    """Name of one camera's clip: that of the scene, with the view if there are several."""
    return scene.name if scene.views == 1 else f"{scene.name}-{view}"


def plain(values: Any) -> Any:
    """Convert an array to nested lists of Python numbers, for JSON."""
    return np.asarray(values).tolist()
