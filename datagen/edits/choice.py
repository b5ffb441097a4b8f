"""Choose at random which object of a scene is edited, and where it goes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from datagen.config import Recipe
from datagen.edits.edit_context import Stage, displaced, with_copy, without
from datagen.render.visible_range import near_object, visible_pixels
from datagen.sampling.poses import Stance, about_vertical
from datagen.schema import EditKind

GROUNDED = 0.01
"""Height of the lowest point, over all frames, up to which an object counts as standing on the table, metres."""


@dataclass(frozen=True, eq=False)
class Edit:
    """One edit of a scene; it changes nothing if no object could be edited."""

    row: int | None
    """Row of the edited object; None if no object could be edited."""
    transform: Float[np.ndarray, "4 4"]
    """World transform, metres, from the old place of the object to that of it or its copy; identity for removals."""
    stage: Stage
    """Stage after the edit."""


def choose_edit(kind: EditKind, recipe: Recipe, stage: Stage, rng: np.random.Generator) -> Edit:
    """Draw an edit of one object, uniformly from the objects that can be edited.

    Every object that shows enough pixels can be removed. A moved object keeps its orientation; a copy is turned about
    the vertical. Both are placed in the region where the recipe's objects start. In all frames, they keep the recipe's
    gap to all other objects and to the old place. The new scene obeys the recipe's rules about visible pixels and the
    workspace.
    """
    seen = _least_visible(recipe, stage) >= recipe.least_visible_pixels if stage.ids else np.zeros(0, bool)
    for row in rng.permutation(np.flatnonzero(seen)):
        if kind == "remove":
            return Edit(int(row), np.eye(4), without(stage, int(row)))
        if edit := _placed(kind, recipe, stage, int(row), rng):
            return edit
    return Edit(None, np.eye(4), stage)


def _placed(kind: EditKind, recipe: Recipe, stage: Stage, row: int, rng: np.random.Generator) -> Edit | None:
    change: Callable[..., Stage] = displaced if kind == "move" else with_copy
    around = _Surroundings(recipe, stage, row)
    if around.lowest > GROUNDED:
        return None
    for _ in range(recipe.layout.tries):
        transform = around.draw(rng, turned=kind == "add")
        if not around.is_free(transform):
            continue
        edited = change(stage, row, transform)
        poses, size = edited.world_from_object, recipe.visibility_resolution
        if np.min(_least_visible(recipe, edited)) < recipe.least_visible_pixels:
            continue
        # No object may come nearer to a camera than renderers can show.
        if not any(near_object(camera, edited.shapes, poses, *size) for camera in edited.scene.cameras):
            return Edit(row, transform, edited)
    return None


class _Surroundings:
    """Free space around an object; each object is an upright cylinder around its centre of mass in each frame."""

    def __init__(self, recipe: Recipe, stage: Stage, row: int):
        frames, objects = stage.world_from_object.shape[:2]
        stances = [
            [Stance(stage.shapes[other], stage.world_from_object[frame, other, :3, :3]) for other in range(objects)]
            for frame in range(frames)
        ]
        self._layout = recipe.layout
        self._centers = stage.world_from_object[:, :, :2, 3]
        self._own = self._centers[:, row]
        reach = np.array([[stance.reach for stance in frame] for frame in stances])
        self._apart = reach + reach[:, [row]] + recipe.layout.gap
        heights = stage.world_from_object[:, row, 2, 3]
        self.lowest = min(float(z) + frame[row].bottom for z, frame in zip(heights, stances, strict=True))
        """Height of the object's lowest point in any frame, metres."""

    def draw(self, rng: np.random.Generator, *, turned: bool) -> Float[np.ndarray, "4 4"]:
        """A transform that brings the object to a random place in frame 0."""
        layout, transform = self._layout, np.eye(4)
        target = np.array(layout.center) + np.array(layout.half_extent) * rng.uniform(-1, 1, 2)
        if turned:
            transform[:3, :3] = about_vertical(rng.uniform(0, 2 * np.pi))
        transform[:2, 3] = target - transform[:2, :2] @ self._own[0]
        return transform

    def is_free(self, transform: Float[np.ndarray, "4 4"]) -> bool:
        """Whether the moved object stays in the workspace and clear of all objects and of its own old place."""
        layout = self._layout
        centers = self._own @ transform[:2, :2].T + transform[:2, 3]
        distance = np.sqrt(np.sum((centers[:, None] - self._centers) ** 2, axis=-1))
        away = np.abs(centers - np.array(layout.center))
        return bool(np.all(distance >= self._apart) and np.all(away < np.array(layout.workspace_half_extent)))


def _least_visible(recipe: Recipe, stage: Stage) -> Int[np.ndarray, "object"]:
    """Fewest pixels that each object shows in any view of frame 0, at the recipe's `visibility_resolution`."""
    return visible_pixels(recipe, stage.scene, stage.shapes, stage.world_from_object[0])
