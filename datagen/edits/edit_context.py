"""A scene with its poses as one value, and functions that edit it.

Edits are kinematic: an object goes, or is elsewhere, in all frames, and nothing else changes; physics is not run again.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8

from datagen.scene import Scene, Trajectory
from datagen.shapes.shape import Shape


@dataclass(frozen=True, eq=False)
class Stage:
    """Everything that a renderer needs; bodies, shapes and poses have the same order."""

    scene: Scene
    shapes: tuple[Shape, ...]
    world_from_object: Float[np.ndarray, "frame object 4 4"]
    """Poses of the objects, metres."""
    ids: tuple[int, ...]
    """Id of each row in segmentations; 0 is the table."""

    def named(self, segmentation: UInt8[np.ndarray, "*image"]) -> UInt8[np.ndarray, "*image"]:
        """Convert a renderer's rows, counted from 1, to ids."""
        return np.array([0, *self.ids], np.uint8)[segmentation]


def stage_of(scene: Scene, shapes: tuple[Shape, ...], trajectory: Trajectory) -> Stage:
    """The scene as it was generated."""
    return Stage(scene, shapes, trajectory.world_from_object, tuple(range(1, len(shapes) + 1)))


def without(stage: Stage, row: int) -> Stage:
    """Remove an object from the scene; the others keep their ids."""
    rest = [other for other in range(len(stage.ids)) if other != row]
    return Stage(
        replace(stage.scene, bodies=tuple(stage.scene.bodies[other] for other in rest)),
        tuple(stage.shapes[other] for other in rest),
        stage.world_from_object[:, rest],
        tuple(stage.ids[other] for other in rest),
    )


def displaced(stage: Stage, row: int, transform: Float[np.ndarray, "4 4"]) -> Stage:
    """Move an object's whole trajectory by a rigid transform of the world."""
    poses = stage.world_from_object.copy()
    poses[:, row] = transform @ poses[:, row]
    return replace(stage, world_from_object=poses)


def with_copy(stage: Stage, row: int, transform: Float[np.ndarray, "4 4"]) -> Stage:
    """Add a copy of the object, moved by a rigid transform of the world; it gets the next free id."""
    copy = transform @ stage.world_from_object[:, [row]]
    return Stage(
        replace(stage.scene, bodies=(*stage.scene.bodies, stage.scene.bodies[row])),
        (*stage.shapes, stage.shapes[row]),
        np.concatenate([stage.world_from_object, copy], axis=1),
        (*stage.ids, max(stage.ids) + 1),
    )
