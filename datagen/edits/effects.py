"""Effects of an object on pixels that do not show it, such as its shadow."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, UInt8

from datagen.edits.edit_context import Stage
from datagen.pipeline.records import render_clip, stack_images
from datagen.render.renderer import Renderer
from datagen.schema import LEAST_EFFECT, SceneRecord

_FINER = 3
"""Number of sample points per pixel along each axis, as in the rasteriser; an object shows if any point hits it."""

Clip = UInt8[np.ndarray, "frame view height width"]
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


def packed(masks: Sequence[Mask], shape: tuple[int, ...]) -> UInt8[np.ndarray, "frame view height width byte"]:
    """Pack one mask per object into bits, eight per byte; one byte of zeros if there are no objects."""
    bits = np.stack(masks, axis=-1) if masks else np.zeros((*shape, 1), bool)
    return np.packbits(bits, axis=-1, bitorder="little")
