"""What an object does to pixels that it does not show in: its shadow."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, UInt8

from datagen.edits.stage import Stage
from datagen.records import render_clip, stack_images
from datagen.render.renderer import Renderer
from datagen.schema import LEAST_EFFECT, SceneRecord

_FINER = 3
"""An object shows in a pixel if it is hit at one of so many by so many points: those of the rasteriser."""

Clip = UInt8[np.ndarray, "frame view height width"]
Mask = Bool[np.ndarray, "frame view height width"]


def touched(stage: Stage, own: SceneRecord, renderer: Renderer) -> dict[int, Mask]:
    """By id, the pixels in which the object shows, be it at a corner: there colour changes because of anti-aliasing."""
    frames, views, height, width = own["segmentation"].shape
    finer = render_clip(stage.scene, stage.shapes, stage.world_from_object, renderer, (_FINER * width, _FINER * height))
    ids = stage.named(stack_images(finer, "segmentation"))
    points = ids.reshape(frames, views, height, _FINER, width, _FINER)
    return {name: np.any(points == name, axis=(3, 5)) for name in stage.ids}


def changed(
    rgb: UInt8[np.ndarray, "frame view height width 3"], other: UInt8[np.ndarray, "frame view height width 3"]
) -> Mask:
    """Where two clips differ visibly."""
    return np.sum(np.abs(rgb.astype(np.int16) - other), axis=-1) >= LEAST_EFFECT


def packed(masks: Sequence[Mask], shape: tuple[int, ...]) -> UInt8[np.ndarray, "frame view height width byte"]:
    """One bit an object, eight to a byte; one byte of zeros where there are no objects."""
    bits = np.stack(masks, axis=-1) if masks else np.zeros((*shape, 1), bool)
    return np.packbits(bits, axis=-1, bitorder="little")
