"""All metrics of a clip at once: validate, count, score."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64, Integer

from benchmark.metrics.agreement import adjusted_mutual_information, adjusted_rand
from benchmark.metrics.boundaries import region_and_boundary
from benchmark.metrics.contingency import compact, count
from benchmark.metrics.detection import detection_scores, hota, idf1
from benchmark.metrics.errors_by_type import identity_switches
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

OTHER_FRAME_METRICS, OTHER_CLIP_METRICS = ("ap50", "pq", "f1", "ami", "ami_fg"), ("hota", "idf1", "j_and_f")
"""Metrics of other benchmarks, of single frames and of whole clips. Older results have none of them."""
OTHER_METRICS = (*OTHER_FRAME_METRICS, *OTHER_CLIP_METRICS)

FrameScores = dict[str, np.ndarray]
"""One value a frame: metrics by name (float64, nan where undefined), and the counts `objects` and `ignored`."""

ClipScores = dict[str, np.ndarray]
"""`FrameScores` of frame * view values, frame by frame; `CLIP_METRICS` and `identity_switches` of one value a view."""


@dataclass(frozen=True, eq=False)
class CountedClip:
    """Label maps of a clip in which cameras stand still, and their contingency tables."""

    truth: Integer[np.ndarray, "frame view height width"]
    prediction: Integer[np.ndarray, "frame view height width"]
    background_slot: int
    tables: Int64[np.ndarray, "frame view truth slot"]


def count_clip(
    truth: Integer[np.ndarray, "frame view height width"],
    prediction: Integer[np.ndarray, "frame view height width"],
    background_slot: int = 0,
    ignore: Bool[np.ndarray, "frame view height width"] | None = None,
) -> CountedClip:
    """Count a clip, whose labels may be renumbered. Ignored pixels become background; arguments as in `clip_scores`."""
    if truth.ndim != 4 or truth.shape != prediction.shape:
        raise ValueError(
            f"Label maps have shapes {truth.shape} and {prediction.shape}; expected one (frame, view, height, width)."
        )
    shape, image = truth.shape, truth.shape[2:]
    one, two = (labels.reshape(-1, *image) for labels in (truth, prediction))
    flat = None if ignore is None else ignore.reshape(-1, *image)
    one, two, slot = compact(one, two, background_slot, flat)
    tables = count(one, two, slot, flat)
    return CountedClip(one.reshape(shape), two.reshape(shape), slot, tables.reshape(*shape[:2], *tables.shape[1:]))


def clip_scores(
    truth: Integer[np.ndarray, "frame view height width"],
    prediction: Integer[np.ndarray, "frame view height width"],
    background_slot: int = 0,
    ignore: Bool[np.ndarray, "frame view height width"] | None = None,
) -> ClipScores:
    """Every metric but `OTHER_METRICS` of a clip with fixed cameras: views are single frames and never count as time.

    Where the clip has one frame there is no time, and `CLIP_METRICS` are nan. Arguments and errors as in `score`.
    """
    return clip_scores_of(count_clip(truth, prediction, background_slot, ignore))


def clip_scores_of(clip: CountedClip) -> ClipScores:
    """Scores of a counted clip, as `clip_scores` gives them."""
    scores = scores_of(clip)
    if len(clip.truth) == 1:
        scores |= {name: np.full_like(scores[name], np.nan) for name in CLIP_METRICS}
    return scores


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
    if truth.ndim != 3 or truth.shape != prediction.shape:
        compact(truth, prediction, background_slot, ignore)  # raises the error
    clip = count_clip(truth[:, None], prediction[:, None], background_slot, None if ignore is None else ignore[:, None])
    scores = scores_of(clip) | other_scores([clip])[0]
    over_time = {name: float(scores[name][0]) for name in (*CLIP_METRICS, *OTHER_CLIP_METRICS)}
    others = {name: mean_where_defined(scores[name]) for name in OTHER_FRAME_METRICS}
    return summarise(scores) | others | over_time | {"identity_switches": int(scores["identity_switches"][0])}


def scores_of(clip: CountedClip) -> ClipScores:
    """Every metric but `OTHER_METRICS`; `CLIP_METRICS` of one frame are its own values."""
    frames, views, *table = clip.tables.shape
    tables = clip.tables.reshape(-1, *table)
    iou = intersection_over_union(tables)
    whole = clip.tables.sum(axis=0)
    return _frame_scores(tables, iou, clip.background_slot, clip.truth[0, 0].size) | {
        "ari_video": adjusted_rand(whole),
        "ari_fg_video": adjusted_rand(whole[:, 1:]),
        "msc_fg_video": covering(intersection_over_union(whole), whole),
        "identity_switches": identity_switches(iou.reshape(frames, views, *table)),
    }


def other_scores(clips: Sequence[CountedClip]) -> list[ClipScores]:
    """Compute `OTHER_METRICS` of clips of equal shape, many at once; nan over time where clips have one frame."""
    frames, views, *image = clips[0].truth.shape
    # Contingency tables of all clips, padded to one size; each view is a clip from here on.
    rows, columns = (max(2, *(clip.tables.shape[axis] for clip in clips)) for axis in (2, 3))
    tables = np.zeros((len(clips), frames, views, rows, columns), np.int64)
    for table, clip in zip(tables, clips, strict=True):
        table[:, :, : clip.tables.shape[2], : clip.tables.shape[3]] = clip.tables
    tables = tables.swapaxes(1, 2).reshape(-1, frames, rows, columns)
    slots = np.repeat([clip.background_slot for clip in clips], views)
    flat = tables.reshape(-1, rows, columns)
    # Overlaps of objects with segments other than the background.
    segments = np.arange(columns) != slots[:, None]
    overlaps = (
        intersection_over_union(flat)[:, 1:].reshape(len(slots), frames, rows - 1, columns) * segments[:, None, None]
    )
    visible, used = tables[:, :, 1:].sum(axis=3) > 0, (tables.sum(axis=2) > 0) & segments[:, None]
    # Scores of single frames.
    scores = detection_scores(overlaps, visible.sum(axis=2), used.sum(axis=2)) | {
        "ami": adjusted_mutual_information(flat).reshape(-1, frames),
        "ami_fg": adjusted_mutual_information(flat[:, 1:]).reshape(-1, frames),
    }
    found = {
        name: values.reshape(-1, views, frames).swapaxes(1, 2).reshape(-1, frames * views)
        for name, values in scores.items()
    }
    # Scores over time.
    if frames == 1:
        over_time = dict.fromkeys(OTHER_CLIP_METRICS, np.full(len(slots), np.nan))
    else:
        truths, predictions = (
            np.stack(maps).swapaxes(1, 2).reshape(-1, frames, *image)
            for maps in ([clip.truth for clip in clips], [clip.prediction for clip in clips])
        )
        over_time = {
            "hota": hota(overlaps, visible, used),
            "idf1": idf1(overlaps, visible, used),
            "j_and_f": region_and_boundary(tables, truths, predictions, slots),
        }
    found |= {name: values.reshape(-1, views) for name, values in over_time.items()}
    return [dict(zip(found, values, strict=True)) for values in zip(*found.values(), strict=True)]


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


def _frame_scores(
    tables: Int64[np.ndarray, "frame truth slot"], iou: Float64[np.ndarray, "frame truth slot"], slot: int, pixels: int
) -> FrameScores:
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


def mean_where_defined(values: np.ndarray) -> float:
    """Mean of the values that are not nan; nan if there are none."""
    defined = values[~np.isnan(values)]
    return float(defined.mean()) if len(defined) else float("nan")
