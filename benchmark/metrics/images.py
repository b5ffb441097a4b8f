"""Similarity of two images of one scene: colours (0 to 1) and depths (metres)."""

import math

import numpy as np
from jaxtyping import Bool, Float

_GAUSSIAN = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
"""Window of Wang et al. (2004)."""


def psnr(
    image: Float[np.ndarray, "*pixels 3"],
    truth: Float[np.ndarray, "*pixels 3"],
    mask: Bool[np.ndarray, "*pixels"] | None = None,
    *,
    largest: float = math.inf,
) -> float:
    """Peak signal-to-noise ratio in dB, at most `largest`, over all pixels or those of the mask; nan over none.

    >>> round(psnr(np.full((4, 4, 3), 0.5), np.full((4, 4, 3), 0.6)), 6)
    20.0
    """
    squares = (image - truth) ** 2 if mask is None else (image - truth)[mask] ** 2
    if squares.size == 0:
        return math.nan
    error = float(squares.mean())
    return min(largest, -10 * math.log10(error)) if error > 0 else largest


def ssim(image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"]) -> float:
    """Structural similarity, the mean of the three channels; 1 for equal images."""
    from skimage.metrics import structural_similarity  # slow import, needed here only

    similarity = structural_similarity(image, truth, channel_axis=-1, data_range=1.0, **_GAUSSIAN)
    return float(np.asarray(similarity))


def depth_errors(
    depth: Float[np.ndarray, "height width"],
    truth: Float[np.ndarray, "height width"],
    mask: Bool[np.ndarray, "height width"] | None = None,
) -> Float[np.ndarray, "pixel"]:
    """Absolute errors in metres of the pixels, or those of the mask, whose true depth is known (not 0)."""
    known = truth > 0 if mask is None else mask & (truth > 0)
    return np.abs(depth - truth)[known]
