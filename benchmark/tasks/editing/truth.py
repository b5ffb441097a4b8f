"""Ground truth of edits: scenes that the generator rendered before and after them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from benchmark.models.editor_interface import Picture
from datagen.errors import UsageError
from datagen.schema import LEAST_EFFECT, EditKind, SceneRecord, decode_depth
from datagen.storage.reader import Dataset, Split

_IMAGES = ("rgb", "depth", "segmentation")

Mask = Bool[np.ndarray, "frame view height width"]


@dataclass(frozen=True, eq=False)
class Pair:
    """A scene before and after an edit."""

    kind: EditKind
    object: int
    """Id of the object that is removed, moved or copied."""
    transform: Float[np.ndarray, "4 4"]
    """Motion of the object or its copy, as a transform of the world in metres; the identity if it is removed."""
    before: Picture
    after: Picture

    @property
    def inside(self) -> Mask:
        """The edited region: pixels that show another object than before, or the table in place of one."""
        return self.before.labels != self.after.labels

    @property
    def shadow(self) -> Mask:
        """Pixels that show the same object or table as before, in another colour."""
        change = np.abs(self.before.rgb - self.after.rgb).sum(axis=-1) * 255
        return ~self.inside & (np.rint(change) >= LEAST_EFFECT)

    @property
    def outside(self) -> Mask:
        """All other pixels."""
        return ~self.inside & ~self.shadow


@dataclass(frozen=True, eq=False)
class EditedScene:
    """A scene and its edits."""

    labels: Integer[np.ndarray, "frame view height width"]
    """Object ids of the unedited scene, all frames."""
    frames: tuple[int, ...]
    """Frames that are scored."""
    before: Picture
    """The unedited scene in these frames."""
    pairs: tuple[Pair, ...]
    """The edits in these frames; some are missing if there was no suitable object or no free place."""


def read_edits(scenes: Split, index: int, kinds: Sequence[EditKind]) -> EditedScene:
    """Read the edits of one scene."""
    record = scenes.read(index, _IMAGES)
    frames = frames_scored(len(record["rgb"]))
    before = _picture(record, "", frames)
    pairs = tuple(_pairs(scenes, index, kinds, before, frames))
    return EditedScene(record["segmentation"], frames, before, pairs)


def frames_scored(count: int) -> tuple[int, ...]:
    """First, middle and last frame of a clip; edits affect all frames, and neighbouring frames are similar.

    >>> frames_scored(10), frames_scored(1)
    ((0, 4, 9), (0,))
    """
    return tuple(sorted({0, (count - 1) // 2, count - 1}))


def _pairs(
    scenes: Split, index: int, kinds: Sequence[EditKind], before: Picture, frames: tuple[int, ...]
) -> Iterator[Pair]:
    for kind in kinds:
        prefix = f"edits/{kind}/"
        facts = [f"{prefix}object", *([] if kind == "remove" else [f"{prefix}transform"])]
        record = scenes.read(index, [*facts, *(prefix + name for name in _IMAGES)])
        if name := int(record[f"{prefix}object"]):
            transform = record.get(f"{prefix}transform", np.eye(4))
            yield Pair(kind, name, transform, before, _picture(record, prefix, frames))


def kinds_in(dataset: Dataset) -> tuple[EditKind, ...]:
    """Kinds of edits in a dataset.

    Raises:
        UsageError: it has no edits.
    """
    if kinds := dataset.edits:
        return kinds
    if dataset.imported:
        raise UsageError(
            f"{dataset.folder} was imported and holds no edits; give a dataset that obpose-datagen generated."
        )
    raise UsageError(
        f"{dataset.folder} holds no edits; make them with: "
        f"obpose-datagen render --from {dataset.folder} --edits remove,move,add --out DIR."
    )


def _picture(record: SceneRecord, prefix: str, frames: tuple[int, ...]) -> Picture:
    rgb, depth, segmentation = (record[prefix + name][list(frames)] for name in _IMAGES)
    return Picture(rgb / 255.0, decode_depth(depth), segmentation)
