"""Edits of a scene as arrays of the format."""

from collections.abc import Mapping

import numpy as np

from datagen.config import Recipe
from datagen.edits.choice import Edit, choose_edit
from datagen.edits.edit_context import Stage, without
from datagen.edits.effects import changed, packed, touched
from datagen.pipeline.records import render_clip, stack_images, stored_depth
from datagen.pipeline.visible_range import check_range
from datagen.render.renderer import Renderer
from datagen.schema import EditKind, SceneRecord

_IMAGES = ("rgb", "depth", "segmentation")


def edits_record(
    stage: Stage,
    pixels: SceneRecord,
    recipe: Recipe,
    renderer: Renderer,
    rngs: Mapping[EditKind, np.random.Generator],
) -> SceneRecord:
    """All fields of the edits of a scene, given its pixels from the same renderer; images are exact, without sensor.

    `rngs` draw which object each kind edits, and where it goes.

    Raises:
        UsageError: an edited object comes too near to a camera, or a depth is farther than the format can hold.
    """
    own = {name: pixels[name] for name in _IMAGES}
    record: SceneRecord = {}
    for kind, rng in rngs.items():
        edit = choose_edit(kind, recipe, stage, rng)
        if kind == "remove":
            record |= _removals(edit, stage, own, renderer)
            continue
        images = own if edit.row is None else _images(edit.stage, own, renderer)
        record |= {f"edits/{kind}/transform": edit.transform, **_fields(kind, edit, images)}
    return record


def _removals(edit: Edit, stage: Stage, own: SceneRecord, renderer: Renderer) -> SceneRecord:
    """Remove every object once, for its effects, and keep the images of one removal."""
    images, effects = own, []
    shown = touched(stage, own, renderer)
    for row, name in enumerate(stage.ids):
        removed = _images(without(stage, row), own, renderer)
        effects.append(changed(own["rgb"], removed["rgb"]) & ~shown[name])
        images = removed if row == edit.row else images
    return {"edits/remove/effects": packed(effects, own["segmentation"].shape), **_fields("remove", edit, images)}


def _fields(kind: EditKind, edit: Edit, images: SceneRecord) -> SceneRecord:
    name = np.asarray(0 if edit.row is None else edit.row + 1, np.uint8)
    return {f"edits/{kind}/object": name, **{f"edits/{kind}/{part}": array for part, array in images.items()}}


def _images(stage: Stage, own: SceneRecord, renderer: Renderer) -> SceneRecord:
    height, width = own["segmentation"].shape[2:]
    check_range(stage.scene, stage.shapes, stage.world_from_object, (width, height))
    images = render_clip(stage.scene, stage.shapes, stage.world_from_object, renderer, (width, height))
    return {
        "rgb": stack_images(images, "rgb"),
        "depth": stored_depth(stack_images(images, "depth")),
        "segmentation": stage.named(stack_images(images, "segmentation")),
    }
