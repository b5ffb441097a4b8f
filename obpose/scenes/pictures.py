"""Pictures of rendered scenes: colour, depth and objects side by side, and turns around the scene."""

import io
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image as Pillow
from torch import Tensor

from datagen.storage.atomic import write_atomically
from obpose.pictures import Picture, colours_of, draw_numbers, enlarged, png, to_bytes
from obpose.scenes.rendering import Image
from obpose.scenes.scene import Camera, upright

PICTURE = "picture.png"
"""File name of the picture in the folder of a saved scene."""
_TILE = 256
"""Height in pixels to which images are enlarged, by a whole factor."""


def strip(image: Image, names: Sequence[int], depths: tuple[float, float] | None = None) -> Picture:
    """Draw colour, depth (near is bright) and segmentation with the objects' numbers side by side, enlarged.

    `depths` are those drawn in white and in black, metres; by default the nearest and the farthest of the image.
    """
    low, high = depths or _range(image)
    grey = ((high - image.depth) / max(high - low, 1e-6))[..., None].expand(-1, -1, 3)
    labels = np.array([0, *names])[image.nearest.numpy()]
    times = max(1, _TILE // image.rgb.shape[0])
    objects = Pillow.fromarray(enlarged(colours_of(labels), times))
    draw_numbers(objects, labels, times)
    parts = [enlarged(to_bytes(image.rgb), times), enlarged(to_bytes(grey), times), np.asarray(objects)]
    return np.concatenate(parts, axis=1)


def strips(images: Iterable[Image], names: Sequence[int]) -> Iterator[Picture]:
    """Draw the strips of an animation; the depths of all of them have the scale of the first image."""
    depths = None
    for image in images:
        depths = depths or _range(image)
        yield strip(image, names, depths)


def _range(image: Image) -> tuple[float, float]:
    """Nearest and farthest depth, metres."""
    return float(image.depth.min()), float(image.depth.max())


def write_png(path: Path, picture: Picture) -> None:
    """Write a PNG atomically."""
    write_atomically(path, png(Pillow.fromarray(picture)))


def write_gif(path: Path, pictures: Iterable[Picture], *, fps: float) -> None:
    """Write a looping GIF atomically."""
    # Pillow's default palette drops the colours of small regions, such as the cap of a bottle.
    first, *rest = (
        Pillow.fromarray(picture).quantize(256, Pillow.Quantize.MAXCOVERAGE, kmeans=2) for picture in pictures
    )
    data = io.BytesIO()
    first.save(data, "GIF", save_all=True, append_images=rest, duration=round(1000 / fps), loop=0)
    write_atomically(path, data.getvalue())


def turned(camera: Camera, center: Tensor, angle: float) -> Camera:
    """Rotate a camera by an angle in radians around the vertical axis through `center`."""
    turn, pose = upright(angle, camera.k), camera.world_from_camera.clone()
    pose[:3, :3] = turn @ pose[:3, :3]
    pose[:3, 3] = center + turn @ (pose[:3, 3] - center)
    return Camera(camera.k, pose, camera.width, camera.height)


def turntable(camera: Camera, center: Tensor, count: int) -> list[Camera]:
    """Rotate a camera around the vertical axis through `center`, in equal steps."""
    return [turned(camera, center, 2 * math.pi * step / count) for step in range(count)]
