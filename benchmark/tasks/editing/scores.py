"""Scores of pictures of edited scenes: colour and depth by region, and segmentation."""

import math

import numpy as np
from jaxtyping import Bool, Float

from benchmark.metrics import clip_scores, mean_where_defined
from benchmark.metrics.images import psnr
from benchmark.tasks.editing.interface import Picture
from benchmark.tasks.editing.truth import Pair

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
