"""Staged scenes whose cameras move."""

import dataclasses

import numpy as np

from datagen.geometry import look_at, quaternion_from_rotation
from datagen.scene import Camera, CameraPose, Scene
from tests.worlds import rendered


def orbiting(world: Scene | None = None) -> Scene:
    """A staged scene whose cameras turn about its middle by 12 degrees from frame to frame."""
    world = world or rendered.scene()
    cameras = tuple(with_path(camera, world.frames) for camera in world.cameras)
    return dataclasses.replace(world, cameras=cameras)


def with_path(camera: Camera, frames: int) -> Camera:
    """The camera with a pose for each frame."""
    target, offset = np.array(camera.target), np.array(camera.position) - np.array(camera.target)
    path = []
    for frame in range(frames):
        cos, sin = np.cos(np.radians(12 * frame)), np.sin(np.radians(12 * frame))
        pose = look_at(target + np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ offset, target)
        w, x, y, z = map(float, quaternion_from_rotation(pose[:3, :3]))
        path.append(CameraPose((float(pose[0, 3]), float(pose[1, 3]), float(pose[2, 3])), (w, x, y, z)))
    return dataclasses.replace(camera, path=tuple(path))
