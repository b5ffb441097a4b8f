"""Pictures of scenes as inferred, fitted to their frames, and edited.

Draws one row per scene, the middle frame of the first view: the input, the scene from codes alone, the scene fitted to
its frames, and the fitted scene with its largest object moved and rotated about the vertical.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from benchmark.studies.inputs import ModelFlags
from datagen.errors import UsageError
from datagen.storage.reader import Dataset
from obpose.scenes import edit
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import fit_to_frames, infer_labelled
from obpose.scenes.model_ref import Origin
from obpose.scenes.pictures import Picture, enlarged, write_png
from obpose.scenes.refine import STEPS
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene, upright

TIMES = 3
"""Pixels of the picture along one pixel of the input."""
SHIFT, TURN = (-0.1, 0.1, 0.0), 1.0
"""Translation in metres and rotation in radians of the moved object."""


@dataclass(frozen=True, kw_only=True)
class Flags(ModelFlags):
    """Options of the study."""

    picture: Path
    """PNG to write."""


def run(flags: Flags) -> None:
    """Draw the picture.

    Raises:
        UsageError: an option is out of range, or there is no such dataset or model.
    """
    if flags.scenes < 1:
        raise UsageError(f"--scenes {flags.scenes}: expected 1 or more.")
    if flags.picture.suffix != ".png":
        raise UsageError(f"--picture {flags.picture}: expected a name that ends with .png.")
    origin, folder = flags.origin(), flags.folder()
    chosen = range(min(flags.scenes, len(Dataset(folder).split(flags.split))))
    rows = [np.concatenate(list(_row(origin, folder, flags, index)), axis=1) for index in chosen]
    write_png(flags.picture, np.concatenate(rows))


def _row(origin: Origin, folder: Path, flags: Flags, index: int) -> Iterator[Picture]:
    clip, renderer = read_clip(folder, flags.split, index), Renderer(origin.model)
    frame = clip.depth.shape[1] // 2
    inferred = infer_labelled(origin, clip)
    camera = inferred.scene.cameras[0]
    camera = camera.resized(TIMES * camera.width, TIMES * camera.height)
    fitted = fit_to_frames(inferred.scene, origin.model, clip, refinements=STEPS)
    yield enlarged(_bytes(clip.rgb[0, frame, 0]), TIMES)
    for scene in (inferred.scene, fitted, move_largest(fitted, inferred.labels[frame, 0])):
        yield _bytes(renderer.render(scene, frame, camera).rgb)


def move_largest(scene: Scene, labels: torch.Tensor) -> Scene:
    """Move and rotate the object with the most pixels; unchanged where the image shows none."""
    if not (labels > 0).any():
        return scene
    name = int(labels[labels > 0].mode().values)
    return edit.rotate(edit.move(scene, name, torch.tensor(SHIFT)), name, upright(TURN, scene.center))


def _bytes(image: torch.Tensor) -> Picture:
    return (image * 255).round().to(torch.uint8).numpy()
