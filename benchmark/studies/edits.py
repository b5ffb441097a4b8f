"""How do a model's edits look beside the generator's?

Draws three rows per scene, first frame and view: the generator's colours, the model's colours, the model's objects. The
dataset must have edits, as `obpose-datagen --edits remove,move,add` makes them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.clips import ClipSequence
from benchmark.models.adapters.editor import SceneEditor
from benchmark.studies.inputs import check_suffix
from benchmark.tasks.editing.answers import match
from benchmark.tasks.editing.interface import Picture
from benchmark.tasks.editing.truth import kinds_in, read_edits
from datagen.errors import UsageError
from datagen.storage.reader import Dataset
from obpose.pictures import PALETTE
from obpose.scenes.pictures import enlarged, write_png
from obpose.storage.pretrained import find_checkpoint

SPLIT = "test"
TILE = 160
"""Images are enlarged by a whole number to about this many pixels."""


@dataclass(frozen=True)
class Flags:
    """Options of the study."""

    data: Path
    """Dataset with edits."""
    checkpoint: Path
    """Folder of a model, or name of shipped weights."""
    picture: Path
    """PNG to write."""
    scenes: tuple[int, ...] = (0,)
    """Test scenes, one below the other."""
    refine: int = 0
    """Steps in which inferred scenes are fitted to their frames, as by `obpose-edit infer`."""


def run(flags: Flags) -> None:
    """Draw the picture.

    Raises:
        UsageError: there is no such scene, or the dataset has no edits.
    """
    check_suffix("--picture", flags.picture, ".png")
    dataset = Dataset(flags.data)
    count, kinds = dataset.splits[SPLIT], kinds_in(dataset)
    if unknown := [scene for scene in flags.scenes if not 0 <= scene < count]:
        raise UsageError(f"--scenes {unknown[0]}: split {SPLIT} of {flags.data} has scenes 0 to {count - 1}.")
    editor, scenes = SceneEditor(find_checkpoint(flags.checkpoint), refinements=flags.refine), dataset.split(SPLIT)
    clips, rows = ClipSequence(scenes), []
    for index in flags.scenes:
        truth = read_edits(scenes, index, kinds)
        scene = editor.infer(clips[index])
        true, edited = [truth.before], [scene.render([0])]
        for pair in truth.pairs:
            label = match(truth.labels, scene.labels, pair.object).label
            true.append(pair.after)
            edited.append(edited[0] if label is None else scene.edited(pair.kind, label, pair.transform, [0]))
        shown = [
            [np.rint(255 * np.clip(p.rgb[0, 0], 0, 1)).astype(np.uint8) for p in pictures]
            for pictures in (true, edited)
        ]
        rows += map(_beside, shown)
        rows.append(_beside([_objects(picture) for picture in edited]))
    write_png(flags.picture, np.concatenate(rows))


def _objects(picture: Picture) -> np.ndarray:
    labels = picture.labels[0, 0]
    return PALETTE[np.where(labels == 0, 0, (labels - 1) % (len(PALETTE) - 1) + 1)]


def _beside(images: Sequence[np.ndarray]) -> np.ndarray:
    return enlarged(np.concatenate(images, axis=1), max(1, TILE // images[0].shape[0]))
