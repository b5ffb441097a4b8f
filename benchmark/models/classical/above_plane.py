"""What stands on the table: the points above the largest plane of a clip."""

import numpy as np
from jaxtyping import Bool, Float

from benchmark.models.classical.points import viewpoints
from benchmark.models.interface import Clip
from obpose.rgbd.plane import fit_plane

LEAST_HEIGHT = 0.001
"""Metres above the plane from which on a point belongs to an object; more cuts off the feet of objects."""
NOISE_FACTOR = 3.0
"""Where the sensor is noisy, points must be higher than this many standard deviations of the plane's own points."""


def standing(
    clip: Clip, points: Float[np.ndarray, "frame view height width 3"], *, seed: int
) -> Bool[np.ndarray, "frame view height width"]:
    """Whether a pixel's point lies above the plane of all frames by more than the plane's noise.

    `points` are those of `scene_points`. Nothing stands where there is no plane, as on no valid pixel.
    """
    plane = fit_plane(points[clip.valid], np.random.default_rng(seed))
    if plane is None:
        return np.zeros_like(clip.valid)
    plane = plane.oriented_towards(viewpoints(clip))
    return clip.valid & (plane.height(points) > max(LEAST_HEIGHT, NOISE_FACTOR * plane.spread))
