"""Paths of moving cameras: orbits, straight lines and a hand's tremor."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from datagen.config import Recipe
from datagen.geometry import look_at, quaternion_from_rotation
from datagen.sampling.poses import about_vertical
from datagen.scene import Camera, CameraPose, rounded, vector

TREMOR = (0.3, 2.0)
"""Range of the frequencies of a hand's tremor, Hz."""

WAVES = 3
"""Number of waves along and about each axis."""


def camera_path(camera: Camera, recipe: Recipe, angle: float, rng: np.random.Generator) -> Camera:
    """Give a camera a pose for each frame, starting with its own; `angle` is its view's about the vertical, radians."""
    make = {"orbit": _orbit, "linear": _linear, "handheld": _handheld}[recipe.rig.motion]
    poses = make(camera, recipe, angle, rng)
    return replace(camera, path=tuple(_pose(pose) for pose in poses))


def _orbit(camera: Camera, recipe: Recipe, angle: float, rng: np.random.Generator) -> list[np.ndarray]:
    target, offset = np.array(camera.target), np.array(camera.position) - np.array(camera.target)
    turns = np.linspace(0, np.radians(recipe.rig.orbit), recipe.frames)
    return [look_at(target + about_vertical(turn) @ offset, target) for turn in turns]


def _linear(camera: Camera, recipe: Recipe, angle: float, rng: np.random.Generator) -> list[np.ndarray]:
    way = about_vertical(angle) @ np.array(recipe.rig.travel)
    target, shares = np.array(camera.target), np.linspace(0, 1, recipe.frames)
    return [look_at(np.array(camera.position) + share * way, target) for share in shares]


def _handheld(camera: Camera, recipe: Recipe, angle: float, rng: np.random.Generator) -> list[np.ndarray]:
    first, seconds = camera.world_from_camera, np.arange(recipe.frames) / recipe.fps
    poses = []
    for shift, turn in zip(_tremor(seconds, rng), _tremor(seconds, rng), strict=True):
        pose = first.copy()
        pose[:3, 3] += recipe.rig.shake * shift
        pose[:3, :3] = first[:3, :3] @ _rotation(np.radians(recipe.rig.sway) * turn)
        poses.append(pose)
    return poses


def _tremor(seconds: Float[np.ndarray, "frame"], rng: np.random.Generator) -> Float[np.ndarray, "frame 3"]:
    """Smooth noise along three axes with a standard deviation of one, relative to its first value."""
    speed, phase = 2 * np.pi * rng.uniform(*TREMOR, (WAVES, 3)), rng.uniform(0, 2 * np.pi, (WAVES, 3))
    noise = np.sum(np.sin(seconds[:, None, None] * speed + phase), axis=1) * np.sqrt(2 / WAVES)
    return noise - noise[0]


def _rotation(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation about the direction of a vector by its length in radians (Rodrigues)."""
    angle = np.sqrt(np.sum(vector * vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _pose(pose: Float[np.ndarray, "4 4"]) -> CameraPose:
    w, x, y, z = (rounded(value) for value in quaternion_from_rotation(pose[:3, :3]))
    return CameraPose(vector(pose[:3, 3]), (w, x, y, z))
