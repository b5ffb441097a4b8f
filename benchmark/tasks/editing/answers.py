"""Pictures to be compared with the ground truth of an edit: those of models, and references.

Scores are colour and depth by region, and the segmentation.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Integer

from benchmark.metrics import clip_scores, mean_where_defined
from benchmark.metrics.images import psnr
from benchmark.models.editor_interface import EditableScene, Picture
from benchmark.tasks.editing.truth import EditedScene, Pair

METRICS = ("psnr_inside", "psnr_shadow", "psnr_outside", "depth_inside", "depth_outside", "ari_fg", "ari")
"""Columns, in the order of tables. Depths are errors in millimetres; of the others, larger is better."""

LARGEST_PSNR = 60.0
"""PSNR of equal pictures, in dB; rounding to bytes alone gives 58.9."""

Depths = Float[np.ndarray, "frame view height width"]
Mask = Bool[np.ndarray, "frame view height width"]


def score(pair: Pair, shown: Picture, truth: Picture | None = None) -> dict[str, float]:
    """Compute all metrics of one picture of a scene, over all frames and views; nan if a region is empty.

    The edit defines the regions (`Pair.inside`, `Pair.shadow`, `Pair.outside`). `truth` is the edited scene by default.
    """
    truth = truth or pair.after
    inside, shadow, outside = pair.inside, pair.shadow, pair.outside
    segmentation = clip_scores(truth.labels, shown.labels, 0, truth.depth == 0)
    return {
        "psnr_inside": psnr(shown.rgb, truth.rgb, inside, largest=LARGEST_PSNR),
        "psnr_shadow": psnr(shown.rgb, truth.rgb, shadow, largest=LARGEST_PSNR),
        "psnr_outside": psnr(shown.rgb, truth.rgb, outside, largest=LARGEST_PSNR),
        "depth_inside": depth_error(truth.depth, shown.depth, inside),
        "depth_outside": depth_error(truth.depth, shown.depth, ~inside),
        # Pixels without depth are ignored, as for segmentations.
        **{name: mean_where_defined(segmentation[name]) for name in ("ari_fg", "ari")},
    }


def depth_error(truth: Depths, shown: Depths, where: Mask) -> float:
    """Median absolute error in millimetres over pixels whose true depth is known; nan if there are none."""
    known = where & (truth > 0)
    return float(1000 * np.median(np.abs(truth[known] - shown[known]))) if known.any() else math.nan


LEAST_IOU = 0.5
"""Minimum IoU of an object and a label for a match."""

EDIT, RECONSTRUCTION = "edit", "reconstruction"


@dataclass(frozen=True)
class Match:
    """Match of an object with a model's label."""

    label: int | None
    """Matching label; None if no label has a larger IoU than `LEAST_IOU`."""
    iou: float
    """IoU of the best label."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Scores of one picture."""

    name: str
    scores: dict[str, float]
    match: Match | None = None
    """Match of the object; None if no model was involved."""


def match(
    truth: Integer[np.ndarray, "frame view height width"],
    labels: Integer[np.ndarray, "frame seen height width"],
    name: int,
) -> Match:
    """Match an object with the label of largest IoU in the views that the model uses.

    Ground truth is used here in place of a person who points at an object.
    """
    wanted = truth[:, : labels.shape[1]] == name
    found = [int(label) for label in np.unique(labels[wanted]) if label]
    ious = {label: float(np.sum(wanted & (labels == label)) / np.sum(wanted | (labels == label))) for label in found}
    if not ious:
        return Match(None, 0.0)
    best = max(ious, key=lambda label: ious[label])
    return Match(best if ious[best] > LEAST_IOU else None, ious[best])


def answers_of(scene: EditableScene, truth: EditedScene) -> Iterator[tuple[Pair, Answer]]:
    """Score a model's edits, each with its reconstruction of the same regions before the edit.

    If no label matches the object, the unedited picture is scored as the edit.
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
    """True picture before the edit: the score of a perfect reconstruction without an edit."""
    return pair.before


def true_pixels(pair: Pair) -> Picture:
    """True picture before the edit, with the true pixels of the edited region; only shadows are wrong."""
    inside = pair.inside
    return replace(
        pair.before,
        rgb=np.where(inside[..., None], pair.after.rgb, pair.before.rgb),
        depth=np.where(inside, pair.after.depth, pair.before.depth),
        labels=pair.after.labels,
    )


REFERENCES: dict[str, Callable[[Pair], Picture]] = {"no-edit": no_edit, "true-pixels": true_pixels}
"""References without a model; both use ground truth."""


def reference_answers(pairs: Iterable[Pair]) -> Iterator[tuple[Pair, Answer]]:
    """Score the references of all pairs."""
    for pair in pairs:
        for name, picture in REFERENCES.items():
            yield pair, Answer(name, score(pair, picture(pair)))
