"""One scene as the checks see it: stored arrays beside geometry that is built anew from the scene's description.

Cameras and rays are computed here from the stored arrays alone, by other code than the renderers use.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Integer

from datagen.config import Physics
from datagen.scene import Scene, scene_from_json
from datagen.schema import DEPTH_SCALE
from datagen.shapes import build
from datagen.shapes.shape import Shape

DEFAULT_PHYSICS = Physics()


@dataclass(frozen=True, eq=False)
class Case:
    """Everything that a check may look at."""

    record: Mapping[str, np.ndarray]
    scene: Scene
    shapes: Sequence[Shape]
    world_from_object: Float[np.ndarray, "frame object 4 4"]
    """From the stored poses."""
    physics: Physics
    """What the recipe allows."""

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

    def center(self, view: int) -> Float[np.ndarray, "3"]:
        """Position of a camera, world frame."""
        return self.record["camera/world_from_camera"][view, :3, 3]

    @cached_property
    def rays(self) -> list[Float[np.ndarray, "height width 3"]]:
        """World directions through the pixel centres of each view; depth times ray is the step from camera to point."""
        return [self._rays(view) for view in range(len(self.record["camera/K"]))]

    def _rays(self, view: int) -> Float[np.ndarray, "height width 3"]:
        height, width = self.record["segmentation"].shape[2:]
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        pixels = np.stack([u, v, np.ones_like(u)], axis=-1)
        rotation = self.record["camera/world_from_camera"][view, :3, :3]
        return (
            np.linalg.solve(self.record["camera/K"][view], pixels.reshape(-1, 3).T).T.reshape(pixels.shape) @ rotation.T
        )

    def project(
        self, points: Float[np.ndarray, "point 3"], view: int
    ) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, "point"]]:
        """Pixel coordinates and depth of world points."""
        rotation = self.record["camera/world_from_camera"][view, :3, :3]
        local = (points - self.center(view)) @ rotation
        homogeneous = local @ self.record["camera/K"][view].T
        z = local[:, 2]
        return homogeneous[:, :2] / np.where(np.abs(z) > 1e-9, z, 1e-9)[:, None], z


def make_case(record: Mapping[str, np.ndarray], physics: Physics = DEFAULT_PHYSICS) -> Case:
    """Build the geometry that a record describes.

    Raises:
        ValueError, KeyError or TypeError: the description cannot be read or built.
    """
    scene = scene_from_json(bytes(record["scene/description"].item()).decode())
    shapes = [build(body.shape) for body in scene.bodies]
    poses = rigid_poses(record["poses/position"], record["poses/quaternion_wxyz"])
    return Case(record, scene, shapes, poses[:, : len(shapes)], physics)


def rigid_poses(
    position: Float[np.ndarray, "frame object 3"], quaternion_wxyz: Float[np.ndarray, "frame object 4"]
) -> Float[np.ndarray, "frame object 4 4"]:
    """world_from_object in float64; rotations by Rodrigues' formula from the quaternion's parts."""
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
