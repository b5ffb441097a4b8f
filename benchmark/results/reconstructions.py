"""Reconstructions on disk: a few scenes of a run as its model renders them, for the report.

RUN/reconstructions/NAME/00017.webp ... images of scene 17 side by side, at most `MOST_IMAGES`

The scenes are spread evenly over the split, so that they are known before anything is scored and equal for all models.
"""

import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from benchmark.models.interface import RECONSTRUCTION_SIDE
from benchmark.results.run_folder import RECONSTRUCTIONS, RunRow
from datagen.errors import CorruptFile
from datagen.storage.atomic import write_atomically
from datagen.storage.safe_io import open_image

MOST_SCENES = 4
MOST_IMAGES = 8
"""Images of a clip; longer clips are sampled evenly."""
QUALITY = 90

Images = UInt8[np.ndarray, "image height width 3"]


def shown_scenes(count: int) -> list[int]:
    """Choose the scenes of a split of `count` scenes that models reconstruct."""
    return _spread(count, MOST_SCENES)


def shown_images(frames: int, views: int) -> list[tuple[int, int]]:
    """Choose the images of a clip that are shown, as frame and view."""
    every = [(frame, view) for frame in range(frames) for view in range(views)]
    return [every[place] for place in _spread(len(every), MOST_IMAGES)]


def _spread(count: int, most: int) -> list[int]:
    return np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist()


def subsampled(image: np.ndarray) -> np.ndarray:
    """Every n-th pixel, such that no side is longer than `RECONSTRUCTION_SIDE`."""
    step = -(-max(image.shape[:2]) // RECONSTRUCTION_SIDE)
    return image[step // 2 :: step, step // 2 :: step]


def save_reconstruction(folder: Path, row: RunRow, scene: int, images: Images) -> None:
    """Write the images of one scene, as `shown_images` chooses them."""
    strip = Image.fromarray(np.concatenate([subsampled(image) for image in images], axis=1))
    file = io.BytesIO()
    strip.save(file, "WEBP", quality=QUALITY, method=6)
    write_atomically(_path(folder, row, scene), file.getvalue())


def load_reconstruction(folder: Path, row: RunRow, scene: int, count: int) -> Images | None:
    """Read the `count` images of one scene; None if the run has none of it.

    Raises:
        CorruptFile: the file is damaged, or has another number of images.
    """
    path = _path(folder, row, scene)
    if not path.is_file():
        return None
    advice = "Delete it: it is only shown in the report."
    try:
        with open_image(path, ("WEBP",)) as image:
            strip = np.asarray(image.convert("RGB"))
    except CorruptFile as error:
        raise CorruptFile(f"{error} {advice}") from None
    if strip.shape[1] % count:
        raise CorruptFile(f"{path} is {strip.shape[1]} pixels wide; expected {count} images of equal width. {advice}")
    return np.stack(np.split(strip, count, axis=1))


def _path(folder: Path, row: RunRow, scene: int) -> Path:
    """Path of a scene's images; seed 0 stands for all seeds of a model without any."""
    key = row.key if row.random else dataclasses.replace(row.key, seed=0)
    return folder / RECONSTRUCTIONS / key.name / f"{scene:05d}.webp"


def chosen_scenes(folder: Path, rows: Sequence[RunRow], count: int) -> list[int]:
    """Choose the scenes of a split that one of these runs has reconstructed; all `count` scenes if there are none."""
    scenes = [scene for scene in shown_scenes(count) if any(_path(folder, row, scene).is_file() for row in rows)]
    return scenes or list(range(count))
