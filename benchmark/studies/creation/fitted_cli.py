"""What fitting scenes to their frames is worth, to the eye.

python -m benchmark.studies.creation.fitted_cli --track moving --scenes 0 1 2 3 --out docs/images/creating_fitted.png

A row for each scene, the frame in the middle, the first view: as seen, from codes alone, fitted to the frames, and with
the largest object carried elsewhere and turned about the vertical.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from benchmark.studies.claims.command import run_command
from benchmark.studies.creation.subject import chosen_origin
from datagen.errors import EXIT_OK, UsageError
from datagen.tracks import find_track
from obpose.scenes import edit
from obpose.scenes.clip import read_clip
from obpose.scenes.infer import fit_to_frames, infer_labelled
from obpose.scenes.model_ref import Origin
from obpose.scenes.pictures import Picture, enlarged, write_png
from obpose.scenes.refine import STEPS
from obpose.scenes.rendering import Renderer
from obpose.scenes.scene import Scene, upright

PROGRAM = "python -m benchmark.studies.creation.fitted_cli"
TIMES = 3
"""Pixels of the picture along a pixel of the input."""
AWAY, TURN = (-0.1, 0.1, 0.0), 1.0
"""Where the object is carried, metres, and how far it is turned, radians."""


@dataclass(frozen=True)
class Arguments:
    """Options of the command."""

    out: Path
    """The picture, PNG."""
    track: str = "moving"
    """Track to look at."""
    checkpoint: str = ""
    """Folder of a trained model, or the name of weights that ship; by default those for pictures of the track."""
    split: Literal["train", "val", "test"] = "test"
    scenes: tuple[int, ...] = (0,)
    """Scenes of the split, one below the other."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Of one model and track."""
    if values.out.suffix != ".png":
        raise UsageError(f"--out {values.out}: expected a name that ends with .png.")
    origin = chosen_origin(values.checkpoint, values.track)
    folder = find_track(values.track).prepare((values.split,))
    rows = [np.concatenate(list(_row(origin, folder, values.split, index)), axis=1) for index in values.scenes]
    write_png(values.out, np.concatenate(rows))
    print(values.out)
    return EXIT_OK


def _row(origin: Origin, folder: Path, split: str, index: int) -> Iterator[Picture]:
    clip, renderer = read_clip(folder, split, index), Renderer(origin.model)
    frame = clip.depth.shape[1] // 2
    found = infer_labelled(origin, clip)
    camera = found.scene.cameras[0]
    camera = camera.resized(TIMES * camera.width, TIMES * camera.height)
    fitted = fit_to_frames(found.scene, origin.model, clip, refinements=STEPS)
    yield enlarged(_bytes(clip.rgb[0, frame, 0]), TIMES)
    for scene in (found.scene, fitted, _carried(fitted, found.labels[frame, 0])):
        yield _bytes(renderer.render(scene, frame, camera).rgb)


def _carried(scene: Scene, labels: torch.Tensor) -> Scene:
    """With the object that most pixels show carried away and turned; as it is where none is seen."""
    if not (labels > 0).any():
        return scene
    name = int(labels[labels > 0].mode().values)
    moved = edit.move(scene, name, torch.tensor(AWAY))
    return edit.rotate(moved, name, upright(TURN, scene.center))


def _bytes(image: torch.Tensor) -> Picture:
    return (image * 255).round().to(torch.uint8).numpy()


if __name__ == "__main__":
    raise SystemExit(main())
