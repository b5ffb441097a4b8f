"""Pictures that are held against the truth of an edit: a model's, and those that make its scores readable."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Integer

from benchmark.tasks.editing.interface import EditableScene, Picture
from benchmark.tasks.editing.scores import score
from benchmark.tasks.editing.truth import EditedScene, Pair

LEAST_IOU = 0.5
"""Of an object's pixels and a label's, from which on the label is the object's."""

EDIT, RECONSTRUCTION = "edit", "reconstruction"


@dataclass(frozen=True)
class Match:
    """The label that a model gives to an object."""

    label: int | None
    """None where no label has more than half of the union."""
    iou: float
    """Of the best label."""


@dataclass(frozen=True, eq=False)
class Answer:
    """One picture and its scores."""

    name: str
    scores: dict[str, float]
    match: Match | None = None
    """Where a model had to find the object."""


def match(
    truth: Integer[np.ndarray, "frame view height width"],
    labels: Integer[np.ndarray, "frame seen height width"],
    name: int,
) -> Match:
    """The label that shares most pixels with an object in the views that were looked at.

    This is where the truth is used, in the place of a person who points at an object.
    """
    wanted = truth[:, : labels.shape[1]] == name
    found = [int(label) for label in np.unique(labels[wanted]) if label]
    ious = {label: float(np.sum(wanted & (labels == label)) / np.sum(wanted | (labels == label))) for label in found}
    if not ious:
        return Match(None, 0.0)
    best = max(ious, key=lambda label: ious[label])
    return Match(best if ious[best] > LEAST_IOU else None, ious[best])


def answers_of(scene: EditableScene, truth: EditedScene) -> Iterator[tuple[Pair, Answer]]:
    """A model's edits, each with its reconstruction of the same regions before the edit.

    Where the model has no label for the object it cannot edit it, and is scored with its unedited picture.
    """
    plain = scene.render(truth.frames) if truth.pairs else None
    for pair in truth.pairs:
        assert plain
        found = match(truth.labels, scene.labels, pair.object)
        edited = plain
        if found.label is not None:
            edited = scene.edited(pair.kind, found.label, pair.transform, truth.frames)
        yield pair, Answer(EDIT, score(pair, edited), found)
        yield pair, Answer(RECONSTRUCTION, score(pair, plain, pair.before))


def no_edit(pair: Pair) -> Picture:
    """The scene as it was: what an editor scores that does nothing, but that perfectly."""
    return pair.before


def true_pixels(pair: Pair) -> Picture:
    """The scene as it was, with the true pixels of the edited region pasted in: all but the shadows is right."""
    inside = pair.inside
    return replace(
        pair.before,
        rgb=np.where(inside[..., None], pair.after.rgb, pair.before.rgb),
        depth=np.where(inside, pair.after.depth, pair.before.depth),
        labels=pair.after.labels,
    )


REFERENCES: dict[str, Callable[[Pair], Picture]] = {"no-edit": no_edit, "true-pixels": true_pixels}
"""Answers that need no model; both use the truth."""


def reference_answers(pairs: Iterable[Pair]) -> Iterator[tuple[Pair, Answer]]:
    """What stands in the tables beside the models."""
    for pair in pairs:
        for name, picture in REFERENCES.items():
            yield pair, Answer(name, score(pair, picture(pair)))
