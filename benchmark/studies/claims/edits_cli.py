"""A picture of edits: the scene, the generator's edits, and a model's.

python -m benchmark.studies.claims.edits_cli --data DIR --checkpoint obpose--clevr3d--80x60 --scenes 0 --out edits.png

DIR holds scenes with edits, as `obpose-datagen --edits remove,move,add` makes them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from PIL import Image

from benchmark.clips import ClipSequence
from benchmark.models.adapters.editor import SceneEditor
from benchmark.studies.claims.command import run_command
from benchmark.tasks.editing.answers import match
from benchmark.tasks.editing.interface import Picture
from benchmark.tasks.editing.truth import kinds_in, read_edits
from datagen.errors import EXIT_OK, UsageError
from datagen.storage.reader import Dataset
from obpose.pictures import PALETTE
from obpose.storage.pretrained import find_checkpoint

PROGRAM = "python -m benchmark.studies.claims.edits_cli"
SPLIT = "test"
TILE = 160
"""Pixels that images are enlarged to, about, by a whole number."""


@dataclass(frozen=True)
class Arguments:
    """Options of the command."""

    data: Path
    """Dataset with edits."""
    checkpoint: Path
    """Folder of a model, or the name of weights that ship with this package."""
    out: Path
    """The picture, PNG."""
    scenes: tuple[int, ...] = (0,)
    """Test scenes, one below the other."""
    refine: int = 0
    """Steps in which inferred scenes are fitted to their frames, as by `obpose-edit infer`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw; give the exit code."""
    return run_command(run, Arguments, arguments, program=PROGRAM, about=__doc__)


def run(values: Arguments) -> int:
    """Three rows for each scene: true colours, the model's colours, the model's objects; the first frame and view."""
    dataset = Dataset(values.data)
    count, kinds = dataset.splits[SPLIT], kinds_in(dataset)
    if unknown := [scene for scene in values.scenes if not 0 <= scene < count]:
        raise UsageError(f"--scenes {unknown[0]}: split {SPLIT} of {values.data} has scenes 0 to {count - 1}.")
    editor, scenes = SceneEditor(find_checkpoint(values.checkpoint), refinements=values.refine), dataset.split(SPLIT)
    clips, rows = ClipSequence(scenes), []
    for index in values.scenes:
        truth = read_edits(scenes, index, kinds)
        scene = editor.infer(clips[index])
        true, shown = [truth.before], [scene.render([0])]
        for pair in truth.pairs:
            label = match(truth.labels, scene.labels, pair.object).label
            true.append(pair.after)
            shown.append(shown[0] if label is None else scene.edited(pair.kind, label, pair.transform, [0]))
        rows += list(_rows(true, shown))
    Image.fromarray(np.concatenate(rows)).save(values.out, optimize=True)
    print(values.out)
    return EXIT_OK


def _rows(true: Sequence[Picture], shown: Sequence[Picture]) -> Iterator[UInt8[np.ndarray, "rows columns 3"]]:
    yield _beside([_colours(picture) for picture in true])
    yield _beside([_colours(picture) for picture in shown])
    yield _beside([_objects(picture) for picture in shown])


def _colours(picture: Picture) -> UInt8[np.ndarray, "height width 3"]:
    return np.rint(255 * np.clip(picture.rgb[0, 0], 0, 1)).astype(np.uint8)


def _objects(picture: Picture) -> UInt8[np.ndarray, "height width 3"]:
    labels = picture.labels[0, 0]
    return PALETTE[np.where(labels == 0, 0, (labels - 1) % (len(PALETTE) - 1) + 1)]


def _beside(images: Sequence[UInt8[np.ndarray, "height width 3"]]) -> UInt8[np.ndarray, "rows columns 3"]:
    times = max(1, TILE // images[0].shape[0])
    return np.concatenate(images, axis=1).repeat(times, axis=0).repeat(times, axis=1)


if __name__ == "__main__":
    raise SystemExit(main())
