"""All metrics of a clip at once: validate, count, score."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Int64, Integer

from benchmark.metrics.adjusted_rand import adjusted_rand
from benchmark.metrics.contingency import contingency
from benchmark.metrics.identity import identity_switches
from benchmark.metrics.overlap import (
    background_overlap,
    best_background_slot,
    covering,
    intersection_over_union,
    one_to_one_overlap,
    oracle_background_overlap,
    without_slot,
)

METRICS = (
    "ari", "ari_fg", "msc_fg", "msc_fg_allslots", "miou_bg", "miou_bg_oracle", "msc_fg_oracle_bg", "miou_fg_hungarian",
)  # fmt: skip
"""Metrics of single frames, in the order of the tables; larger is better, and 1 is best for all."""

CLIP_METRICS = ("ari_video", "ari_fg_video", "msc_fg_video")
"""Metrics of whole clips, with all frames of a view as one image in space and time."""

FrameScores = dict[str, np.ndarray]
"""One value a frame: metrics by name (float64, nan where undefined), and the counts `objects` and `ignored`."""

ClipScores = dict[str, np.ndarray]
"""`FrameScores` of frame * view values, frame by frame; `CLIP_METRICS` and `identity_switches` of one value a view."""


def frame_scores(
    truth: Integer[np.ndarray, "frame height width"],
    prediction: Integer[np.ndarray, "frame height width"],
    background_slot: int = 0,
    ignore: Bool[np.ndarray, "frame height width"] | None = None,
) -> FrameScores:
    """Every metric in every frame by itself; arguments and errors as in `score`."""
    tables, slot = contingency(truth, prediction, background_slot, ignore)
    return _frame_scores(tables, slot, truth[0].size)


def clip_scores(
    truth: Integer[np.ndarray, "frame view height width"],
    prediction: Integer[np.ndarray, "frame view height width"],
    background_slot: int = 0,
    ignore: Bool[np.ndarray, "frame view height width"] | None = None,
) -> ClipScores:
    """Every metric of a clip in which cameras stand still: views are frames of their own and never count as time.

    Where the clip has one frame there is no time, and `CLIP_METRICS` are nan. Arguments and errors as in `score`.
    """
    if truth.ndim != 4 or truth.shape != prediction.shape:
        raise ValueError(
            f"Label maps have shapes {truth.shape} and {prediction.shape}; expected one (frame, view, height, width)."
        )
    frames, views, *image = truth.shape
    one, two = (labels.reshape(-1, *image) for labels in (truth, prediction))
    tables, slot = contingency(one, two, background_slot, None if ignore is None else ignore.reshape(-1, *image))
    scores = _frame_scores(tables, slot, truth[0, 0].size)
    over_time = _clip_scores(tables.reshape(frames, views, *tables.shape[1:]))
    if frames == 1:
        over_time |= {name: np.full(views, np.nan) for name in CLIP_METRICS}
    return scores | over_time


def score(
    truth: Integer[np.ndarray, "frame height width"],
    prediction: Integer[np.ndarray, "frame height width"],
    background_slot: int = 0,
    ignore: Bool[np.ndarray, "frame height width"] | None = None,
) -> dict[str, float]:
    """Score label maps frame by frame and average over frames. Label 0 of `truth` is the background.

    - `ari`: adjusted Rand index over all pixels; `ari_fg`: over the pixels of true objects.
    - `msc_fg`: mean over objects of the best IoU with a predicted segment, the predicted background slot being no
      candidate (the paper's rule); `msc_fg_allslots`: with all slots as candidates (GENESIS-V2's rule, = mBO).
    - `miou_bg`: IoU of the background with the predicted background slot.
    - `miou_bg_oracle` and `msc_fg_oracle_bg`: `miou_bg` and `msc_fg` with the slot as background that suits the truth
      best, frame by frame. In a frame without true background the first is nan, and the second has all slots as
      candidates. Both use the truth, so they must not be ranked beside the others.
    - `miou_fg_hungarian`: mean IoU of objects and slots matched one to one; an unmatched object counts 0.
    - `ari_video`, `ari_fg_video`, `msc_fg_video` (all slots): the frames as one image in space and time, so that an
      object must keep its slot. Of one frame they are the frame's own values.
    - `identity_switches`: how often an object's best slot differs from its slot when it was last visible.

    What a frame leaves undefined (nothing in it is an object, or nothing is background) is nan there, stays out of the
    mean and is counted in `n_undefined`. Pixels in `ignore` count nowhere but in `n_ignored`. For clips with several
    views there is `clip_scores`.

    >>> truth = np.array([[[0, 0, 1, 1], [0, 0, 2, 2]]])
    >>> scores = score(truth, np.array([[[0, 0, 1, 1], [0, 0, 0, 2]]]))
    >>> scores["msc_fg"], scores["miou_bg"], scores["ari_fg"]
    (0.75, 0.8, 0.5714285714285714)

    Raises:
        ValueError: the maps differ in shape, are not integer, hold negative labels outside `ignore`, or are empty, or
            the background slot is negative.
    """
    tables, slot = contingency(truth, prediction, background_slot, ignore)
    frames = _frame_scores(tables, slot, truth[0].size)
    over_time = _clip_scores(tables[:, None])
    summary = summarise(frames) | {name: float(over_time[name][0]) for name in CLIP_METRICS}
    return summary | {"identity_switches": int(over_time["identity_switches"][0])}


def summarise(frames: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Means over the frames in which a metric is defined, and counts over all frames.

    `n_undefined` counts frames in which at least one metric is nan, `n_one_object` those in which ARI-FG can only be 0
    or 1, `n_ignored` pixels.
    """
    undefined = np.any([np.isnan(frames[name]) for name in METRICS], axis=0)
    means = {name: mean_where_defined(frames[name]) for name in METRICS}
    return means | {
        "n_frames": len(undefined),
        "n_undefined": int(undefined.sum()),
        "n_one_object": int(np.sum(frames["objects"] == 1)),
        "n_ignored": int(np.sum(frames["ignored"])),
    }


def _frame_scores(tables: Int64[np.ndarray, "frame truth slot"], slot: int, pixels: int) -> FrameScores:
    iou = intersection_over_union(tables)
    return {
        "ari": adjusted_rand(tables),
        "ari_fg": adjusted_rand(tables[:, 1:]),
        "msc_fg": covering(np.delete(iou, slot, axis=2), tables),
        "msc_fg_allslots": covering(iou, tables),
        "miou_bg": background_overlap(iou, tables, slot),
        "miou_bg_oracle": oracle_background_overlap(iou, tables),
        "msc_fg_oracle_bg": covering(without_slot(iou, best_background_slot(iou, tables)), tables),
        "miou_fg_hungarian": one_to_one_overlap(iou, tables),
        "objects": np.count_nonzero(tables[:, 1:].sum(axis=2), axis=1),
        "ignored": pixels - tables.sum(axis=(1, 2)),
    }


def _clip_scores(tables: Int64[np.ndarray, "frame view truth slot"]) -> ClipScores:
    frames, views, *table = tables.shape
    whole = tables.sum(axis=0)
    iou = intersection_over_union(tables.reshape(-1, *table)).reshape(frames, views, *table)
    return {
        "ari_video": adjusted_rand(whole),
        "ari_fg_video": adjusted_rand(whole[:, 1:]),
        "msc_fg_video": covering(intersection_over_union(whole), whole),
        "identity_switches": identity_switches(iou),
    }


def mean_where_defined(values: np.ndarray) -> float:
    """Mean of the values that are not nan; nan if there are none."""
    defined = values[~np.isnan(values)]
    return float(defined.mean()) if len(defined) else float("nan")
