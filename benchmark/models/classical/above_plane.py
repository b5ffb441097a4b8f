"""Segmentation of the points above the largest plane of a clip, the table."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int64, UInt8

from benchmark.models.classical.points import Untrained, keep_largest, pixel_width, scene_points, viewpoints
from benchmark.models.interface import Clip, Prediction
from datagen.rgbd.plane import fit_plane

LEAST_HEIGHT = 0.001
"""Height in metres above which a point belongs to an object; larger values cut off the feet of objects."""
NOISE_FACTOR = 3.0
"""Minimum height in standard deviations of the plane's own points, for noisy sensors."""


@dataclass
class PlaneClustering(Untrained):
    """Base of models that cluster the points above the plane, frame by frame; labels have no identity over time."""

    def segment(self, clip: Clip) -> Prediction:
        """Label 0 is the plane, anything below it, holes and lone points; clusters count from 1 in every frame."""
        points, pixel = scene_points(clip), pixel_width(clip)
        labels = np.zeros(clip.depth.shape, np.int64)
        for frame, mask in enumerate(standing(clip, points, seed=self.seed)):
            if mask.any():
                labels[frame][mask] = keep_largest(self.cluster(points[frame][mask], clip.rgb[frame][mask], pixel))
        return Prediction(labels, background_slot=0)

    def cluster(
        self, points: Float[np.ndarray, "point 3"], rgb: UInt8[np.ndarray, "point 3"], pixel: float
    ) -> Int64[np.ndarray, "point"]:
        """Cluster of each point, counted from 1; 0 for points in no cluster. `pixel` is a pixel's width in metres."""
        raise NotImplementedError


def standing(
    clip: Clip, points: Float[np.ndarray, "frame view height width 3"], *, seed: int
) -> Bool[np.ndarray, "frame view height width"]:
    """Find the pixels whose points lie above the plane of all frames by more than the plane's noise.

    `points` are those of `scene_points`. There are none if no plane is found, such as in clips without valid pixels.
    """
    plane = fit_plane(points[clip.valid], np.random.default_rng(seed))
    if plane is None:
        return np.zeros_like(clip.valid)
    plane = plane.oriented_towards(viewpoints(clip))
    return clip.valid & (plane.height(points) > max(LEAST_HEIGHT, NOISE_FACTOR * plane.spread))
