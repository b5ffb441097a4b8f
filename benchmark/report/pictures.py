"""Small pictures as data URIs: images, depth, label maps whose colours stay with their slots, and bounding boxes."""

import base64
import io
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int64, Integer, UInt8
from PIL import Image, ImageDraw

from benchmark.metrics.box_overlap import CORNERS, EDGES
from benchmark.metrics.overlap import best_pairs
from benchmark.models.interface import RECONSTRUCTION_SIDE
from benchmark.results.reconstructions import subsampled
from datagen.geometry import project
from datagen.inspect.preview import colored_depth, label_colors

GAP = 2
"""Transparent pixels between the images of a strip."""

NEAREST = 0.05
"""Least depth of a box's corners, metres; boxes nearer to the camera, or behind it, are not drawn."""

Rgb = UInt8[np.ndarray, "height width 3"]
Labels = Integer[np.ndarray, "height width"]
Colors = UInt8[np.ndarray, "label 3"]


def slot_colors(tables: Int64[np.ndarray, "frame truth slot"], background_slot: int) -> Colors:
    """Choose one colour for each slot of a clip: that of the object with which it shares most pixels over the clip.

    The background slot is dark, as in the ground truth; slots without an object get colours of their own.
    """
    truths, slots = tables.shape[1:]
    names = np.arange(slots) + truths
    shared = tables.sum(axis=0)[1:]
    shared[:, background_slot] = 0
    rows, columns = np.nonzero(best_pairs(shared) & (shared > 0))
    names[columns] = rows + 1
    names[background_slot] = 0
    return label_colors(truths + slots)[names]


def photograph(images: Sequence[Rgb]) -> str:
    """Encode images side by side, lossy."""
    return _uri([subsampled(image) for image in images], quality=80)


def depth_picture(depths: Sequence[Labels], near: float, far: float) -> str:
    """Encode depths (stored units) side by side, in the colours of the dataset's preview."""
    return _uri([colored_depth(subsampled(depth), near, far) for depth in depths], quality=80)


def label_picture(labels: Sequence[Labels], colors: Colors) -> str:
    """Encode label maps side by side, lossless."""
    return _uri([colors[subsampled(image)] for image in labels], lossless=True)


def boxes_picture(images: Sequence[Rgb], corners: Sequence[Float[np.ndarray, "label 8 2"]], colors: Colors) -> str:
    """Encode images side by side with the edges of bounding boxes; boxes with nan corners are left out."""
    drawn = []
    for image, boxes in zip(images, corners, strict=True):
        scale = max(1, RECONSTRUCTION_SIDE // max(image.shape[:2]))
        picture = Image.fromarray(image // 2 + 64).resize((image.shape[1] * scale, image.shape[0] * scale))
        pen = ImageDraw.Draw(picture)
        for label in np.flatnonzero(np.isfinite(boxes).all(axis=(1, 2))):
            for ends in EDGES:
                line = [tuple((boxes[label, end] * scale).tolist()) for end in ends]
                pen.line(line, fill=tuple(colors[label].tolist()) if label < len(colors) else (255, 255, 255))
        drawn.append(subsampled(np.asarray(picture)))
    return _uri(drawn, quality=85)


def box_corners(
    center: Float[np.ndarray, "label 3"],
    rotation: Float[np.ndarray, "label 3 3"],
    size: Float[np.ndarray, "label 3"],
    k: Float[np.ndarray, "3 3"],
    world_from_camera: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "label 8 2"]:
    """Project the corners of boxes in world coordinates to pixels; nan for boxes that reach behind the camera."""
    points = center[:, None] + np.einsum("lij,lcj->lci", rotation, CORNERS * size[:, None])
    pixels, depth = project(points, k, world_from_camera)
    hidden = ~np.all(depth > NEAREST, axis=1)
    return np.where(hidden[:, None, None], np.nan, pixels)


def _uri(images: Sequence[Rgb], **options: bool | int) -> str:
    opaque = [np.dstack([image, np.full(image.shape[:2], 255, np.uint8)]) for image in images]
    gap = np.zeros((opaque[0].shape[0], GAP, 4), np.uint8)
    strip = Image.fromarray(np.concatenate([part for image in opaque for part in (gap, image)][1:], axis=1))
    file = io.BytesIO()
    (strip.convert("RGB") if len(images) == 1 else strip).save(file, "WEBP", method=4, **options)
    return "data:image/webp;base64," + base64.b64encode(file.getvalue()).decode()
