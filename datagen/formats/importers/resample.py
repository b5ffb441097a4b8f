"""Images of any size at a wanted one: the middle of the image with the wanted aspect, scaled."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from PIL import Image

from datagen.formats.importers.interface import Images
from datagen.rgbd.images import Size


def resampled(images: Images, size: Size) -> Images:
    """Crop all images to the aspect of `size` (width, height) and scale them; camera matrices follow.

    Colours are averages over the area of a pixel. Depth and ids are those of the nearest pixel, because averages of
    either do not exist in the scene. Camera matrices are those of the pixels that depth is taken from.
    """
    height, width = images.depth.shape[2:]
    if (width, height) == size:
        return images
    left, top, right, bottom = box = _crop((width, height), size)
    columns, rows = _nearest(left, right, size[0]), _nearest(top, bottom, size[1])
    scaled = [_scaled(rgb, box, size) for rgb in images.rgb.reshape(-1, height, width, 3)]
    return replace(
        images,
        rgb=np.stack(scaled).reshape(*images.rgb.shape[:2], size[1], size[0], 3),
        depth=images.depth[:, :, rows[:, None], columns],
        k=_scale_cameras(images.k, box, size, (_offset(columns, left, right), _offset(rows, top, bottom))),
        ids=None if images.ids is None else images.ids[:, :, rows[:, None], columns],
    )


def _crop(size: Size, wanted: Size) -> tuple[float, float, float, float]:
    """Largest box of the wanted aspect in the middle of an image: left, top, right, bottom."""
    scale = min(size[0] / wanted[0], size[1] / wanted[1])
    x, y = (size[0] - scale * wanted[0]) / 2, (size[1] - scale * wanted[1]) / 2
    return x, y, size[0] - x, size[1] - y


def _nearest(start: float, end: float, count: int) -> np.ndarray:
    return np.floor(start + (np.arange(count) + 0.5) * (end - start) / count).astype(np.int64)


def _offset(places: np.ndarray, start: float, end: float) -> float:
    """Mean distance of the pixels taken from the wanted places; half a pixel if one of an even number is taken."""
    count = len(places)
    return float(np.mean(places + 0.5 - start - (np.arange(count) + 0.5) * (end - start) / count))


def _scaled(rgb: np.ndarray, box: tuple[float, float, float, float], size: Size) -> np.ndarray:
    return np.asarray(Image.fromarray(rgb).resize(size, Image.Resampling.BOX, box=box))


def _scale_cameras(
    k: Float64[np.ndarray, "image view 3 3"],
    box: tuple[float, float, float, float],
    size: Size,
    offset: tuple[float, float],
) -> Float64[np.ndarray, "image view 3 3"]:
    left, top, right, bottom = box
    moved = k - np.array([[0, 0, left + offset[0]], [0, 0, top + offset[1]], [0, 0, 0]])
    return moved * np.array([size[0] / (right - left), size[1] / (bottom - top), 1.0])[:, None]
