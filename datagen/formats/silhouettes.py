"""Silhouettes of objects: each rendered without the others, from the scene that a dataset stores."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool

from datagen.edits.edit_context import Stage
from datagen.errors import CorruptFile, UsageError
from datagen.formats.scenes import ExportScene
from datagen.pipeline.records import scene_and_trajectory
from datagen.render import make_renderer
from datagen.render.renderer import render_clip, stack_images
from datagen.shapes import build


def stage_of_scene(scene: ExportScene) -> Stage:
    """The scene's shapes and poses.

    Raises:
        UsageError: it holds meshes of a user, and their folder was not given.
        CorruptFile: its description is damaged.
    """
    try:
        described, trajectory = scene_and_trajectory(scene.record())
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise CorruptFile(
            f"{scene.place}: scene/description is damaged ({error}). Delete the shard and run the command that made it "
            "again."
        ) from None
    if scene.meshes is None and any(body.shape.family == "mesh" for body in described.bodies):
        raise UsageError(
            f"{scene.place} holds meshes of your own, whose models this format needs. Give the folder that holds them "
            "with --assets."
        )
    shapes = tuple(build(body.shape, scene.meshes) for body in described.bodies)
    return Stage(described, shapes, trajectory.world_from_object, tuple(range(1, len(shapes) + 1)))


def silhouettes(scene: ExportScene, stage: Stage) -> Iterator[Bool[np.ndarray, "frame view height width"]]:
    """Pixels whose centre each object would cover without the other objects, object by object."""
    renderer = make_renderer(scene.label_renderer)
    for row, shape in enumerate(stage.shapes):
        alone = replace(stage.scene, bodies=(stage.scene.bodies[row],))
        images = render_clip(alone, [shape], stage.world_from_object[:, [row]], renderer, scene.size)
        yield stack_images(images, "segmentation") > 0
