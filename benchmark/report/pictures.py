"""Small pictures as data URIs: photographs, depth, and label maps whose colours stay with their slots."""

import base64
import io
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int64, Integer, UInt8
from PIL import Image
from scipy.optimize import linear_sum_assignment

from datagen.inspect.preview import colored_depth, label_colors

SIDE = 96
"""Pixels that the longer side of one image has at most; larger ones are thinned out."""

GAP = 2
"""Transparent pixels between the images of a strip."""

Rgb = UInt8[np.ndarray, "height width 3"]
Labels = Integer[np.ndarray, "height width"]


def slot_colors(tables: Int64[np.ndarray, "frame truth slot"], background_slot: int) -> UInt8[np.ndarray, "slot 3"]:
    """One colour for each slot of a clip: that of the true object it covers best over the whole clip.

    The background slot is dark, as in the truth; slots left over get colours of their own.
    """
    truths, slots = tables.shape[1:]
    names = np.arange(slots) + truths
    rows, columns = linear_sum_assignment(-tables.sum(axis=0)[1:])
    names[columns] = rows + 1
    names[background_slot] = 0
    return label_colors(truths + slots)[names]


def photograph(images: Sequence[Rgb]) -> str:
    """Images side by side, compressed with loss."""
    return _uri(_row([thin(image) for image in images]), quality=80)


def depth_picture(depths: Sequence[Labels], near: float, far: float) -> str:
    """Depths (stored units) side by side, in the colours of the dataset's preview."""
    return _uri(_row([colored_depth(thin(depth), near, far) for depth in depths]), quality=80)


def label_picture(labels: Sequence[Labels], colors: UInt8[np.ndarray, "label 3"]) -> str:
    """Label maps side by side, exact to the pixel."""
    return _uri(_row([colors[thin(image)] for image in labels]), lossless=True)


def thin(image: np.ndarray) -> np.ndarray:
    """Every n-th pixel, such that no side is longer than `SIDE`."""
    step = -(-max(image.shape[:2]) // SIDE)
    return image[step // 2 :: step, step // 2 :: step]


def _row(images: Sequence[Rgb]) -> UInt8[np.ndarray, "height row 4"]:
    opaque = [np.dstack([image, np.full(image.shape[:2], 255, np.uint8)]) for image in images]
    gap = np.zeros((opaque[0].shape[0], GAP, 4), np.uint8)
    return np.concatenate([part for image in opaque for part in (gap, image)][1:], axis=1)


def _uri(pixels: np.ndarray, **options: bool | int) -> str:
    file = io.BytesIO()
    image = Image.fromarray(pixels)
    (image.convert("RGB") if np.all(pixels[..., 3] == 255) else image).save(file, "WEBP", method=4, **options)
    return "data:image/webp;base64," + base64.b64encode(file.getvalue()).decode()
