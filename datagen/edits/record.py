"""Edits of a scene as arrays of the format."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, UInt8

from datagen.config import Recipe
from datagen.edits.choice import Edit, choose_edit
from datagen.edits.edit_context import Stage, without
from datagen.render.renderer import PathTracer, Renderer, photographs, render_clip, stack_images
from datagen.render.visible_range import check_range
from datagen.schema import LEAST_EFFECT, EditKind, SceneRecord, encode_depth

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
            record |= _removals(edit, stage, own, renderer, pixels["visibility/amodal_pixels"].shape[2])
            continue
        images = own if edit.row is None else _images(edit.stage, own, renderer)
        record |= {f"edits/{kind}/transform": edit.transform, **_fields(kind, edit, images, renderer)}
    return record


def _removals(edit: Edit, stage: Stage, own: SceneRecord, renderer: Renderer, rows: int) -> SceneRecord:
    """Remove every object once, for its effects, and keep the images of one removal; `rows` is the object axis."""
    images, effects = own, []
    shown = touched(stage, own, renderer)
    for row, name in enumerate(stage.ids):
        removed = _images(without(stage, row), own, renderer)
        effects.append(changed(own["rgb"], removed["rgb"]) & ~shown[name])
        images = removed if row == edit.row else images
    return {
        "edits/remove/effects": packed(effects, own["segmentation"].shape, rows),
        **_fields("remove", edit, images, renderer),
    }


def _fields(kind: EditKind, edit: Edit, images: SceneRecord, renderer: Renderer) -> SceneRecord:
    if isinstance(renderer, PathTracer):
        stage, (height, width) = edit.stage, images["segmentation"].shape[2:]
        colors = photographs(stage.scene, stage.shapes, stage.world_from_object, renderer, (width, height))
        images = {**images, "rgb": colors}
    name = np.asarray(0 if edit.row is None else edit.row + 1, np.uint8)
    return {f"edits/{kind}/object": name, **{f"edits/{kind}/{part}": array for part, array in images.items()}}


def _images(stage: Stage, own: SceneRecord, renderer: Renderer) -> SceneRecord:
    height, width = own["segmentation"].shape[2:]
    check_range(stage.scene, stage.shapes, stage.world_from_object, (width, height))
    images = render_clip(stage.scene, stage.shapes, stage.world_from_object, renderer, (width, height))
    return {
        "rgb": stack_images(images, "rgb"),
        "depth": encode_depth(stack_images(images, "depth")),
        "segmentation": stage.named(stack_images(images, "segmentation")),
    }


_FINER = 3
"""Number of sample points per pixel along each axis, as in the rasteriser; an object shows if any point hits it."""

Mask = Bool[np.ndarray, "frame view height width"]


def touched(stage: Stage, own: SceneRecord, renderer: Renderer) -> dict[int, Mask]:
    """Pixels that show each object, even at a corner, by id; anti-aliasing changes their colour."""
    frames, views, height, width = own["segmentation"].shape
    finer = render_clip(stage.scene, stage.shapes, stage.world_from_object, renderer, (_FINER * width, _FINER * height))
    ids = stage.named(stack_images(finer, "segmentation"))
    points = ids.reshape(frames, views, height, _FINER, width, _FINER)
    return {name: np.any(points == name, axis=(3, 5)) for name in stage.ids}


def changed(
    rgb: UInt8[np.ndarray, "frame view height width 3"], other: UInt8[np.ndarray, "frame view height width 3"]
) -> Mask:
    """Mask of the pixels in which two clips differ visibly."""
    return np.sum(np.abs(rgb.astype(np.int16) - other), axis=-1) >= LEAST_EFFECT


def packed(
    masks: Sequence[Mask], shape: tuple[int, ...], rows: int
) -> UInt8[np.ndarray, "frame view height width byte"]:
    """Pack one mask per object into bits, eight per byte, with zeros for the other rows of the object axis."""
    bits = np.zeros((*shape, rows), bool)
    for row, mask in enumerate(masks):
        bits[..., row] = mask
    return np.packbits(bits, axis=-1, bitorder="little")
