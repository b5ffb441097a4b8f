"""All metrics of a clip at once: validate, count, score."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Integer

from benchmark.metrics.adjusted_rand import adjusted_rand
from benchmark.metrics.contingency import contingency
from benchmark.metrics.overlap import background_overlap, covering, intersection_over_union

METRICS = ("ari", "ari_fg", "msc_fg", "msc_fg_allslots", "miou_bg", "miou_bg_oracle")
"""In the order in which tables show them; larger is better, 1 is best for all."""

FrameScores = dict[str, np.ndarray]
"""One value a frame: metrics by name (float64, nan where undefined), and the counts `objects` and `ignored`."""


def frame_scores(
    truth: Integer[np.ndarray, "frame height width"],
    prediction: Integer[np.ndarray, "frame height width"],
    background_slot: int = 0,
    ignore: Bool[np.ndarray, "frame height width"] | None = None,
) -> FrameScores:
    """Every metric in every frame by itself; arguments and errors as in `score`."""
    tables, slot = contingency(truth, prediction, background_slot, ignore)
    iou = intersection_over_union(tables)
    return {
        "ari": adjusted_rand(tables),
        "ari_fg": adjusted_rand(tables[:, 1:]),
        "msc_fg": covering(np.delete(iou, slot, axis=2), tables),
        "msc_fg_allslots": covering(iou, tables),
        "miou_bg": background_overlap(iou, tables, slot),
        "miou_bg_oracle": iou[:, 0].max(axis=1),
        "objects": np.count_nonzero(tables[:, 1:].sum(axis=2), axis=1),
        "ignored": truth[0].size - tables.sum(axis=(1, 2)),
    }


def summarise(frames: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Means over the frames in which a metric is defined, and counts over all frames.

    `n_undefined` counts frames in which at least one metric is nan, `n_one_object` those in which ARI-FG can only be 0
    or 1, `n_ignored` pixels.
    """
    undefined = np.any([np.isnan(frames[name]) for name in METRICS], axis=0)
    means = {name: _mean_where_defined(frames[name]) for name in METRICS}
    return means | {
        "n_frames": len(undefined),
        "n_undefined": int(undefined.sum()),
        "n_one_object": int(np.sum(frames["objects"] == 1)),
        "n_ignored": int(np.sum(frames["ignored"])),
    }


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
    - `miou_bg`: IoU of the background with the predicted background slot; `miou_bg_oracle`: with the best slot.

    What a frame leaves undefined (nothing in it is an object, or nothing is background) is nan there, stays out of the
    mean and is counted in `n_undefined`. Pixels in `ignore` count nowhere but in `n_ignored`. Views are passed as
    frames.

    >>> truth = np.array([[[0, 0, 1, 1], [0, 0, 2, 2]]])
    >>> scores = score(truth, np.array([[[0, 0, 1, 1], [0, 0, 0, 2]]]))
    >>> scores["msc_fg"], scores["miou_bg"], scores["ari_fg"]
    (0.75, 0.8, 0.5714285714285714)

    Raises:
        ValueError: the maps differ in shape, are not integer, hold negative labels outside `ignore`, or are empty.
    """
    return summarise(frame_scores(truth, prediction, background_slot, ignore))


def _mean_where_defined(values: np.ndarray) -> float:
    defined = values[~np.isnan(values)]
    return float(defined.mean()) if len(defined) else float("nan")
