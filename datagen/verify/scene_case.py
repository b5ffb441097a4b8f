"""Input of the checks: stored arrays of one scene, and geometry rebuilt from the scene's description.

Cameras and rays are computed here from the stored arrays alone, by code that the renderers do not use.
"""

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Integer

from datagen.config import Physics, Sensor
from datagen.scene import Scene, scene_from_json
from datagen.schema import DEPTH_SCALE
from datagen.shapes import build
from datagen.shapes.shape import MeshSource, Shape


@dataclass(frozen=True)
class Finding:
    """One contradiction in a dataset; a place, such as `scene`, is None if the finding is not specific to one."""

    check: str
    """Name of the check that failed, see `docs/dataset.md`."""
    message: str
    """Description of the error, with the measured and the allowed value."""
    split: str | None = None
    shard: str | None = None
    scene: int | None = None
    frame: int | None = None
    view: int | None = None

    def __str__(self) -> str:
        """Place, check and figure."""
        places = ("split", "shard", "scene", "frame", "view")
        where = " ".join(f"{name} {getattr(self, name)}" for name in places if getattr(self, name) is not None)
        return f"{where or 'dataset'}: {self.check}: {self.message}"


@dataclass(frozen=True)
class Precision:
    """Errors of a renderer."""

    snap: float = 0.0
    """Distance by which a triangle's corners may move sideways, pixels."""
    depth_steps: float = 0.0
    """Step of the depth buffer at a depth of 1 m, metres; grows with the square of depth."""

    path_traced: bool = False
    """Whether labels that follow from colours follow from those of the rasteriser, which are not stored."""

    def sideways(self, depth: np.ndarray, focal: np.ndarray | float) -> np.ndarray:
        """Largest shift of a surface across the line of sight at a given depth, metres; focal length in pixels."""
        return self.snap * depth / focal

    def buffer(self, depth: np.ndarray) -> np.ndarray:
        """Largest error of the depth buffer at a given depth, metres."""
        return self.depth_steps * depth**2


OPENGL = Precision(snap=1 / 256, depth_steps=2.0**-24 / 0.05)
"""Precision of OpenGL: corners have 8 subpixel bits, and the depth buffer has 24 bits and a near plane at 5 cm."""

PRECISION = {
    "raster": Precision(),
    "rich": Precision(),
    "pyrender": OPENGL,
    "mitsuba": Precision(path_traced=True),
}
"""Precision of each renderer by name."""


def rounding(rays: Float[np.ndarray, "*shape 3"], steps: float) -> Float[np.ndarray, "*shape"]:
    """Length along rays, in metres, of a number of steps of stored depth; rays are given per unit of depth."""
    return steps * DEPTH_SCALE * np.sqrt(np.sum(rays**2, axis=-1))


@dataclass(frozen=True)
class Allowed:
    """Settings of a dataset that decide how far its arrays may be from the exact geometry."""

    physics: Physics = field(default_factory=Physics)
    """Physics constants, which limit how deep contacts may be."""
    sensor: Sensor = field(default_factory=Sensor)
    """Sensor constants, which determine the noise of sensor depth."""
    precision: Precision = PRECISION["raster"]
    """Errors that the renderer may make."""


DEFAULT = Allowed()

_MOST_RAYS = 10_000_000
"""Largest number of rays kept in memory."""


@dataclass(frozen=True, eq=False)
class Case:
    """Everything that a check may use."""

    record: Mapping[str, np.ndarray]
    scene: Scene
    shapes: Sequence[Shape]
    world_from_object: Float[np.ndarray, "frame object 4 4"]
    """Object poses as matrices, computed from the stored positions and quaternions."""
    allowed: Allowed = DEFAULT
    """Tolerances that follow from the recipe and the renderer."""

    @property
    def count(self) -> int:
        """Number of objects."""
        return len(self.scene.bodies)

    @property
    def images(self) -> Iterator[tuple[int, int]]:
        """Frame and view of every image."""
        frames, views = self.record["segmentation"].shape[:2]
        return ((frame, view) for frame in range(frames) for view in range(views))

    def segmentation(self, frame: int, view: int) -> Integer[np.ndarray, "height width"]:
        """Stored ids of one image."""
        return self.record["segmentation"][frame, view]

    def depth(self, frame: int, view: int) -> Float[np.ndarray, "height width"]:
        """Stored depth of one image, metres."""
        return self.record["depth"][frame, view] * DEPTH_SCALE

    def at(self, frame: int) -> "Case":
        """The case with the cameras as they are in one frame; the same case if they do not move."""
        poses = self.record.get("camera/world_from_camera_of_frame")
        if poses is None:
            return self
        return replace(self, record={**self.record, "camera/world_from_camera": poses[frame]})

    def center(self, view: int) -> Float[np.ndarray, "3"]:
        """Position of a camera, world frame."""
        return self.record["camera/world_from_camera"][view, :3, 3]

    @cached_property
    def focal(self) -> Float[np.ndarray, "view"]:
        """Focal length of each view, pixels; the smaller of its two."""
        return np.min(self.record["camera/K"][:, [0, 1], [0, 1]], axis=1)

    @cached_property
    def rays(self) -> "ViewRays":
        """World rays through the pixel centres of each view; depth times ray is the vector from camera to point."""
        height, width = self.record["segmentation"].shape[2:]
        return ViewRays(self.record["camera/K"], self.record["camera/world_from_camera"], height, width)

    def project(
        self, points: Float[np.ndarray, "point 3"], view: int
    ) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, "point"]]:
        """Pixel coordinates and depth of world points."""
        rotation = self.record["camera/world_from_camera"][view, :3, :3]
        local = (points - self.center(view)) @ rotation
        homogeneous = local @ self.record["camera/K"][view].T
        z = local[:, 2]
        return homogeneous[:, :2] / np.where(np.abs(z) > 1e-9, z, 1e-9)[:, None], z


class ViewRays:
    """Rays of each view, indexed by view; for large images, only the latest views stay in memory."""

    def __init__(
        self,
        k: Float[np.ndarray, "view 3 3"],
        world_from_camera: Float[np.ndarray, "view 4 4"],
        height: int,
        width: int,
    ):
        self._k, self._world_from_camera, self._height, self._width = k, world_from_camera, height, width
        self._get = functools.lru_cache(max(2, _MOST_RAYS // (height * width)))(self._make)

    def __getitem__(self, view: int) -> Float[np.ndarray, "height width 3"]:
        """Directions of one view, per unit of depth."""
        return self._get(view)

    def _make(self, view: int) -> Float[np.ndarray, "height width 3"]:
        u, v = np.meshgrid(np.arange(self._width) + 0.5, np.arange(self._height) + 0.5)
        pixels = np.stack([u, v, np.ones_like(u)], axis=-1)
        directions = np.linalg.solve(self._k[view], pixels.reshape(-1, 3).T).T.reshape(pixels.shape)
        return directions @ self._world_from_camera[view, :3, :3].T


def make_case(record: Mapping[str, np.ndarray], allowed: Allowed = DEFAULT, meshes: MeshSource | None = None) -> Case:
    """Build the geometry that a record describes.

    Raises:
        ValueError, KeyError or TypeError: the description cannot be read or built.
    """
    scene = scene_from_json(bytes(record["scene/description"].item()).decode())
    shapes = [build(body.shape, meshes) for body in scene.bodies]
    poses = rigid_poses(record["poses/position"], record["poses/quaternion_wxyz"])
    return Case(record, scene, shapes, poses[:, : len(shapes)], allowed)


def rigid_poses(
    position: Float[np.ndarray, "frame object 3"], quaternion_wxyz: Float[np.ndarray, "frame object 4"]
) -> Float[np.ndarray, "frame object 4 4"]:
    """Poses world_from_object in float64; rotations by Rodrigues' formula from the quaternion's parts."""
    q = quaternion_wxyz.astype(np.float64)
    q = q / np.maximum(np.sqrt(np.sum(q * q, axis=-1, keepdims=True)), 1e-12)
    w, (x, y, z) = q[..., 0, None, None], np.moveaxis(q[..., 1:], -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    poses = np.zeros((*x.shape, 4, 4))
    poses[..., :3, :3] = np.eye(3) + 2 * w * cross + 2 * cross @ cross
    poses[..., :3, 3] = position
    poses[..., 3, 3] = 1
    return poses
